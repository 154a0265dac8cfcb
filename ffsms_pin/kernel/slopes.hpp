// How joint positions change the arm's velocities and functions of its coupling, in closed form; forces.
//
// Turning joint k by its twist S_k carries everything beyond it as one rigid body, with inertia I_k. On a
// base that moves on as it did, with V_k the twist of the link before it and h_k the momentum of all that it
// carries, that body's momentum changes by
//
//     S_k x* h_k - I_k (S_k x V_k),
//
// and the base by what the momentum equation asks for. The whole is linear in the rates, so no derivative of
// a single column is needed: neither for velocities, which sum the columns with the rates, nor for functions
// of the coupling, whose slopes by the columns are summed backwards through the same equations.
//
// Reference: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 2 (spatial cross products), 5
// and 9.
#pragma once

#include "arm.hpp"

namespace ffsms {

// Of the link before each joint, at given rates, and slopes of the momentum by the joint.
template <class T>
struct Moved {
  Vec3<T> omega[kMostJoints], velocity[kMostJoints];  // angular; linear, of the point at the origin
  Vec3<T> linear[kMostJoints], angular[kMostJoints];  // slopes
};

// The base moves on with angular velocity `spin` and linear velocity `root`.
template <class T>
void moved(const Tree& tree, const Arm<T>& arm, const T* rates, const Vec3<T>& spin, const Vec3<T>& root,
           Moved<T>& out) {
  Vec3<T> linear[kMostJoints], angular[kMostJoints];  // momentum of what each carries, the base still
  for (int j = 0; j < tree.n; ++j) {
    const int parent = tree.joints[j].parent;
    out.omega[j] = parent < 0 ? spin : out.omega[parent] + rates[parent] * arm.axis[parent];
    out.velocity[j] = parent < 0 ? root : out.velocity[parent] + rates[parent] * arm.velocity[parent];
    linear[j] = rates[j] * arm.linear[j];
    angular[j] = rates[j] * arm.angular[j];
  }
  for (int j = tree.n - 1; j >= 0; --j) {
    const int parent = tree.joints[j].parent;
    if (parent < 0) continue;
    linear[parent] += linear[j];
    angular[parent] += angular[j];
  }
  for (int j = 0; j < tree.n; ++j) {
    const double mass = tree.joints[j].carried_mass;
    const Vec3<T>&a = arm.axis[j], &v = arm.velocity[j], &f = arm.moment[j];
    const Vec3<T>&omega = out.omega[j], &before = out.velocity[j];
    linear[j] += mass * before + cross(omega, f);
    angular[j] += arm.inertia[j] * omega + cross(f, before);
    const Vec3<T> turn = cross(a, omega), shift = cross(a, before) + cross(v, omega);  // S x V
    out.linear[j] = cross(a, linear[j]) - mass * shift - cross(turn, f);
    out.angular[j] = cross(a, angular[j]) + cross(v, linear[j]) - arm.inertia[j] * turn - cross(f, shift);
  }
}

// Sum of columns with the rates.
template <class T>
Vec3<T> summed(const Tree& tree, const Vec3<T>* columns, const T* rates) {
  Vec3<T> out = {};
  for (int j = 0; j < tree.n; ++j) out += rates[j] * columns[j];
  return out;
}

// Of the base's angular velocity, spin @ rates + own, and of the end effector's velocity, jstar @ rates +
// own x rho. `own` is what an angular momentum adds to the spin: the momentum stays in base axes, so own
// changes with the inertia that the joints change.
template <class T>
void velocity_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, const Vec3<T>& own,
                     Vec3<T>* spin_slopes, Vec3<T>* tip_slopes) {
  const Vec3<T> spin = summed(tree, arm.spin, rates) + own;
  const Vec3<T> root = summed(tree, arm.root, rates) + cross(arm.com, own);
  const Vec3<T> velocity = summed(tree, arm.jstar, rates) + cross(own, arm.tip - arm.com);
  Moved<T> by;
  moved(tree, arm, rates, spin, root, by);
  for (int j = 0; j < tree.n; ++j) {
    Vec3<T> root_slope;
    react(tree, arm, by.linear[j], by.angular[j], spin_slopes[j], root_slope);
    tip_slopes[j] = root_slope + cross(spin_slopes[j], arm.tip) + cross(by.omega[j], arm.tip_velocity[j]);
    // The end effector turns about the joint with its velocity beyond the link before it.
    if (!tree.joints[j].moves_tip) continue;
    tip_slopes[j] += cross(arm.axis[j], velocity - by.velocity[j] - cross(by.omega[j], arm.tip));
  }
}

// Of the end effector's angular velocity on a fixed base.
template <class T>
void turning_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, Vec3<T>* out) {
  const Vec3<T> tip = summed(tree, arm.tip_spin, rates);
  Vec3<T> before[kMostJoints];
  for (int j = 0; j < tree.n; ++j) {
    const int parent = tree.joints[j].parent;
    before[j] = parent < 0 ? Vec3<T>{} : before[parent] + rates[parent] * arm.axis[parent];
    // A joint turns the axes of all joints beyond it; its own stays, and its own rate drops out.
    out[j] = cross(arm.tip_spin[j], tip - before[j]);
  }
}

// Of the angular momentum about the centre of mass, the base's attitude held, its place as the mode has it.
template <class T>
void momentum_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, Vec3<T>* out) {
  Moved<T> by;
  Vec3<T> root = {};
  for (int j = 0; j < tree.n; ++j) root += rates[j] * (-tree.inverse_mass * arm.linear[j]);
  moved(tree, arm, rates, Vec3<T>{}, root, by);
  for (int j = 0; j < tree.n; ++j) out[j] = by.angular[j] - cross(arm.com, by.linear[j]);
}

// Slopes by a joint's twist that moves or is moved: by its velocity, by the outer product of its axis.
template <class T>
struct ByTwist {
  Vec3<T> velocity;
  Mat3<T> outer;

  void add(const ByTwist& other) {
    velocity += other.velocity;
    outer += other.outer;
  }
};

// Gradient (n) of a function of the coupling that has the slopes `by_coupling` (6, n).
template <class T>
void coupling_slopes(const Tree& tree, const Arm<T>& arm, const T* by_coupling, T* gradient) {
  const auto by = [&](int row, int j) { return by_coupling[row * tree.n + j]; };
  const Vec3<T> base_com = tree.base_com;
  Vec3<T> by_axis[kMostJoints], by_velocity[kMostJoints];  // of the columns that a joint carries: they turn
  ByTwist<T> own[kMostJoints];
  ByTwist<T> base = {Vec3<T>{}, Mat3<T>{}};
  for (int j = 0; j < tree.n; ++j) {
    // Slopes by root and spin, then by the momenta that these answer: the base's inertia is symmetric.
    const Vec3<T> by_root = {{by(0, j), by(1, j), by(2, j)}};
    const Vec3<T> by_turn = {{by(3, j), by(4, j), by(5, j)}};
    const Vec3<T> by_spin = by_turn + cross(base_com, by_root);
    Vec3<T> x, y;
    react(tree, arm, by_root, by_spin, x, y);
    by_axis[j] = cross(arm.angular[j], x) + cross(arm.linear[j], y);
    by_velocity[j] = cross(arm.linear[j], x);
    own[j] = {cross(y, arm.axis[j]) + cross(arm.velocity[j], x), outer(x, arm.axis[j])};
    base.add({cross(y, arm.spin[j]) + cross(arm.root[j], x), outer(x, arm.spin[j])});
  }
  for (int j = tree.n - 1; j >= 0; --j) {
    const int parent = tree.joints[j].parent;
    if (parent < 0) continue;
    by_axis[parent] += by_axis[j];
    by_velocity[parent] += by_velocity[j];
  }
  ByTwist<T> before[kMostJoints];
  for (int j = 0; j < tree.n; ++j) {
    // Columns of joints before it, and the base, answer to the inertia of what it carries.
    const int parent = tree.joints[j].parent;
    before[j] = parent < 0 ? base : before[parent];
    if (parent >= 0) before[j].add(own[parent]);
    Mat3<T> both = before[j].outer;
    both += transposed(before[j].outer);
    const Mat3<T> N = arm.inertia[j] * both;
    const T trace = both[0][0] + both[1][1] + both[2][2];
    const Vec3<T> turned = {{N[1][2] - N[2][1], N[2][0] - N[0][2], N[0][1] - N[1][0]}};
    const Vec3<T> shifted = trace * arm.moment[j] - both * arm.moment[j];
    gradient[j] = dot(arm.axis[j], by_axis[j] + turned) + dot(arm.velocity[j], by_velocity[j] + shifted) +
                  dot(arm.linear[j], before[j].velocity);
  }
}

// -- torques of the joints, the base reacting, H_q u' + C_q, and what holds the base where a mode holds it
//
// Seen from an inertial frame that moves along with the root's origin at the instant: an even velocity
// changes no force. Newton and Euler give the force on each body while the base is not accelerated; a joint
// bears that of all that it carries. The base then gives way in whatever is free of it. A joint's torque gets
// the base's twist a rate of the joint times the force on the whole: N^T f, where N^T M is zero in the base's
// columns. What is not free bears the force on the whole.
//
// Torques (n), then force and moment about the base's centre of mass. `own_spin`: what the total momentum
// adds to the base's angular velocity.
template <class T>
void dynamics(const Tree& tree, const Arm<T>& arm, const T* rates, const T* accelerations,
              const Vec3<T>& own_spin, T* torques, Vec3<T>& held_force, Vec3<T>& held_moment) {
  const Vec3<T> turning = summed(tree, arm.spin, rates) + own_spin;
  // Where the base's centre of mass is held, the root's origin goes round it.
  const Vec3<T> inwards = cross(turning, cross(turning, Vec3<T>(tree.base_com)));
  const Vec3<T> pulled = tree.moves ? Vec3<T>{} : -1.0 * inwards;
  // Of each body: twist and its rate of change at the origin; the force on it.
  Vec3<T> spin[kMostJoints], velocity[kMostJoints], spin_rate[kMostJoints], velocity_rate[kMostJoints];
  Vec3<T> force[kMostJoints], moment[kMostJoints];
  for (int j = 0; j < tree.n; ++j) {
    const Body& body = tree.joints[j].body;
    const int up = tree.joints[j].parent;
    const Vec3<T> own_turn = rates[j] * arm.axis[j], own_shift = rates[j] * arm.velocity[j];
    spin[j] = (up < 0 ? turning : spin[up]) + own_turn;
    velocity[j] = (up < 0 ? Vec3<T>{} : velocity[up]) + own_shift;
    spin_rate[j] = accelerations[j] * arm.axis[j] + cross(spin[j], own_turn);
    velocity_rate[j] =
        accelerations[j] * arm.velocity[j] + cross(spin[j], own_shift) + cross(velocity[j], own_turn);
    if (up >= 0) spin_rate[j] += spin_rate[up];
    velocity_rate[j] += up < 0 ? pulled : velocity_rate[up];
    const Vec3<T> centre = arm.origin[j] + arm.rotation[j] * body.lever;
    const Vec3<T> moves = velocity[j] + cross(spin[j], centre);
    force[j] = body.mass * (velocity_rate[j] + cross(spin_rate[j], centre) + cross(spin[j], moves));
    const Mat3<T> back = transposed(arm.rotation[j]);
    const Vec3<T> change = arm.rotation[j] * (Mat3<T>(body.inertia) * (back * spin_rate[j]));
    const Vec3<T> momentum = arm.rotation[j] * (Mat3<T>(body.inertia) * (back * spin[j]));
    moment[j] = change + cross(spin[j], momentum) + cross(centre, force[j]);
  }
  // Of the base itself; where its centre of mass is held, no force is on it.
  Vec3<T> first = tree.base_moment;  // of mass, of the whole
  Vec3<T> whole_force = tree.moves ? cross(turning, cross(turning, first)) : Vec3<T>{};
  Vec3<T> whole_moment = cross(turning, Mat3<T>(tree.base_inertia) * turning) + cross(first, pulled);
  for (int j = tree.n - 1; j >= 0; --j) {
    const int up = tree.joints[j].parent;
    (up < 0 ? whole_force : force[up]) += force[j];
    (up < 0 ? whole_moment : moment[up]) += moment[j];
    if (up < 0) first += arm.moment[j];
  }
  for (int j = 0; j < tree.n; ++j) {
    torques[j] = dot(arm.axis[j], moment[j]) + dot(arm.velocity[j], force[j]) +
                 dot(arm.root[j], whole_force) + dot(arm.spin[j], whole_moment);
  }
  // About the point that does not move, or the centre of mass where the whole moves.
  held_moment = whole_moment - cross(arm.com, whole_force);
  held_force = Vec3<T>{};
  if (!tree.moves) {
    // A base that turns freely turns by what no moment holds; what it carries goes round with it.
    const Vec3<T> turned = -1.0 * (arm.inverse * held_moment);
    held_force = whole_force + cross(turned, first - tree.total_mass * arm.com);
  }
  if (tree.turns_freely) held_moment = Vec3<T>{};
}

}  // namespace ffsms
