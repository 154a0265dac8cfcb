// Gradients by the joint positions of the arm's velocities and of functions of C_bm, in closed form; torques.
//
// A displacement of joint k along its twist S_k moves all bodies beyond it as one rigid body with the inertia
// I_k and the momentum h_k. With V_k the twist of the link before the joint, and the base's twist unchanged,
// the momentum of these bodies changes by
//
//     S_k x* h_k - I_k (S_k x V_k),
//
// and the change of the base's twist follows from the momentum equation. All equations are linear in the
// rates, so derivatives of single columns are not needed: velocities are sums of the columns times the rates,
// and the derivatives of functions of C_bm are propagated backwards through the same equations.
//
// Reference: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 2 (spatial cross products), 5
// and 9.
#pragma once

#include "arm.hpp"

namespace ffsms {

// The twist of the link before each joint, and the gradient of the momentum by the joint's position.
template <class T>
struct MomentumGradient {
  Vec3<T> omega[kMostJoints], velocity[kMostJoints];  // angular; linear, of the point at the origin
  Vec3<T> linear[kMostJoints], angular[kMostJoints];  // slopes
};

// Computes `MomentumGradient` for a base with the angular velocity `spin` and the root's velocity `root`.
template <class T>
void momentum_gradient(const Tree& tree, const Arm<T>& arm, const T* rates, const Vec3<T>& spin,
                       const Vec3<T>& root, MomentumGradient<T>& out) {
  Vec3<T> linear[kMostJoints], angular[kMostJoints];  // momentum of all bodies that a joint moves
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

// Returns the sum over the joints of column times rate.
template <class T>
Vec3<T> summed(const Tree& tree, const Vec3<T>* columns, const T* rates) {
  Vec3<T> out = {};
  for (int j = 0; j < tree.n; ++j) out += rates[j] * columns[j];
  return out;
}

// Computes the gradients (3, n) of the base's angular velocity, spin @ rates + own, and of the end effector's
// velocity, jstar @ rates + own x rho. `own` is the part of the angular velocity due to an angular momentum
// that is constant in base axes, so it changes with the inertia.
template <class T>
void velocity_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, const Vec3<T>& own,
                     Vec3<T>* spin_slopes, Vec3<T>* tip_slopes) {
  const Vec3<T> spin = summed(tree, arm.spin, rates) + own;
  const Vec3<T> root = summed(tree, arm.root, rates) + cross(arm.com, own);
  const Vec3<T> velocity = summed(tree, arm.jstar, rates) + cross(own, arm.tip - arm.com);
  MomentumGradient<T> by;
  momentum_gradient(tree, arm, rates, spin, root, by);
  for (int j = 0; j < tree.n; ++j) {
    Vec3<T> root_slope;
    react(tree, arm, by.linear[j], by.angular[j], spin_slopes[j], root_slope);
    tip_slopes[j] = root_slope + cross(spin_slopes[j], arm.tip) + cross(by.omega[j], arm.tip_velocity[j]);
    // The joint rotates the end effector's velocity relative to the link before the joint.
    if (!tree.joints[j].moves_tip) continue;
    tip_slopes[j] += cross(arm.axis[j], velocity - by.velocity[j] - cross(by.omega[j], arm.tip));
  }
}

// Computes the gradient (3, n) of the end effector's angular velocity on a fixed base.
template <class T>
void turning_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, Vec3<T>* out) {
  const Vec3<T> tip = summed(tree, arm.tip_spin, rates);
  Vec3<T> before[kMostJoints];
  for (int j = 0; j < tree.n; ++j) {
    const int parent = tree.joints[j].parent;
    before[j] = parent < 0 ? Vec3<T>{} : before[parent] + rates[parent] * arm.axis[parent];
    // A joint rotates the axes of all joints beyond it, but not its own axis.
    out[j] = cross(arm.tip_spin[j], tip - before[j]);
  }
}

// Computes the gradient (3, n) of the angular momentum about the centre of mass, with the base's attitude
// held and its position free or held as in the mode.
template <class T>
void momentum_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, Vec3<T>* out) {
  MomentumGradient<T> by;
  Vec3<T> root = {};
  for (int j = 0; j < tree.n; ++j) root += rates[j] * (-tree.inverse_mass * arm.linear[j]);
  momentum_gradient(tree, arm, rates, Vec3<T>{}, root, by);
  for (int j = 0; j < tree.n; ++j) out[j] = by.angular[j] - cross(arm.com, by.linear[j]);
}

// Derivatives of a function by the first moment and by the inertia of bodies.
template <class T>
struct ByInertia {
  Vec3<T> moment;
  Mat3<T> inertia;

  void add(const ByInertia& other) {
    moment += other.moment;
    inertia += other.inertia;
  }
};

// Computes the gradient (n) of a function of C_bm from its derivative `by_coupling` (6, n) by C_bm.
template <class T>
void coupling_slopes(const Tree& tree, const Arm<T>& arm, const T* by_coupling, T* gradient) {
  const auto by = [&](int row, int j) { return by_coupling[row * tree.n + j]; };
  const Vec3<T> base_com = tree.base_com;
  Vec3<T> by_axis[kMostJoints], by_velocity[kMostJoints];  // summed over the columns that a joint moves
  ByInertia<T> own[kMostJoints];
  ByInertia<T> base = {Vec3<T>{}, Mat3<T>{}};
  for (int j = 0; j < tree.n; ++j) {
    // The derivatives by the root's velocity and spin, then those by the momenta. `react` is its own
    // transpose, because the system's inertia is symmetric.
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
  ByInertia<T> before[kMostJoints];
  for (int j = 0; j < tree.n; ++j) {
    // The inertia of the bodies that the joint moves affects the columns of the joints before it, and the
    // momentum due to the base's twist.
    const int parent = tree.joints[j].parent;
    before[j] = parent < 0 ? base : before[parent];
    if (parent >= 0) before[j].add(own[parent]);
    Mat3<T> both = before[j].inertia;
    both += transposed(before[j].inertia);
    const Mat3<T> N = arm.inertia[j] * both;
    const T trace = both[0][0] + both[1][1] + both[2][2];
    const Vec3<T> turned = {{N[1][2] - N[2][1], N[2][0] - N[0][2], N[0][1] - N[1][0]}};
    const Vec3<T> shifted = trace * arm.moment[j] - both * arm.moment[j];
    gradient[j] = dot(arm.axis[j], by_axis[j] + turned) + dot(arm.velocity[j], by_velocity[j] + shifted) +
                  dot(arm.linear[j], before[j].moment);
  }
}

// -- joint torques H_q u' + C_q with the base reacting, and the force and moment that hold the base in a mode
//
// The inertial frame moves with the root's origin at the instant, because a constant velocity changes no
// force. Newton's and Euler's equations give the force on each body without an acceleration of the base, and
// a joint transmits the force on all bodies that it moves. Let f_b be the force on the whole system. A free
// base accelerates under f_b, which adds N_b^T f_b to the joint torques, where N_b is the base's twist per
// joint rate. If the mode holds the base, f_b is the holding force.
//
// Computes the torques (n), then the force and the moment about the base's centre of mass. `own_spin` is the
// part of the base's angular velocity due to the total momentum.
template <class T>
void dynamics(const Tree& tree, const Arm<T>& arm, const T* rates, const T* accelerations,
              const Vec3<T>& own_spin, T* torques, Vec3<T>& held_force, Vec3<T>& held_moment) {
  const Vec3<T> turning = summed(tree, arm.spin, rates) + own_spin;
  // If the base's centre of mass is held, the root's origin moves on a circle round it.
  const Vec3<T> inwards = cross(turning, cross(turning, Vec3<T>(tree.base_com)));
  const Vec3<T> pulled = tree.moves ? Vec3<T>{} : -1.0 * inwards;
  // The twist of each body at the origin, the rate of the twist, and the force and moment on the body.
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
  // The force and moment on the base itself; if its centre of mass is held, the force is zero.
  Vec3<T> first = tree.base_moment;  // first moment of mass of the whole system
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
  // The moment about the base's centre of mass if this point is held, else about the system's centre of mass.
  held_moment = whole_moment - cross(arm.com, whole_force);
  held_force = Vec3<T>{};
  if (!tree.moves) {
    // A base that rotates freely has this angular acceleration, which accelerates all bodies.
    const Vec3<T> turned = -1.0 * (arm.inverse * held_moment);
    held_force = whole_force + cross(turned, first - tree.total_mass * arm.com);
  }
  if (tree.turns_freely) held_moment = Vec3<T>{};
}

}  // namespace ffsms
