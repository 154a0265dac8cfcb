// How joint positions change the arm's velocities and functions of its coupling, in closed form.
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
// Reference: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 2 (spatial cross products).
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

// Of the base's angular velocity, spin @ rates, and of the end effector's velocity, jstar @ rates.
template <class T>
void velocity_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, Vec3<T>* spin_slopes,
                     Vec3<T>* tip_slopes) {
  const Vec3<T> spin = summed(tree, arm.spin, rates), root = summed(tree, arm.root, rates);
  const Vec3<T> velocity = summed(tree, arm.jstar, rates);
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

// Of the angular momentum about the centre of mass, the base's attitude held and its place free.
template <class T>
void momentum_slopes(const Tree& tree, const Arm<T>& arm, const T* rates, Vec3<T>* out) {
  Moved<T> by;
  moved(tree, arm, rates, Vec3<T>{}, summed(tree, arm.root, rates), by);
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

}  // namespace ffsms
