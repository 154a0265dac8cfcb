// The robot: a base, and a tree of revolute and prismatic joints with a body on each joint. Kinematics and
// momentum of the arm at one configuration, or at one configuration per lane of a pack.
//
// All quantities of the arm are in base axes with the root's origin at zero, so they depend on the joint
// positions alone. Column j of a Jacobian is the value per unit rate of joint j.
#pragma once

#include "vec3.hpp"

namespace ffsms {

constexpr int kMostJoints = 64;

struct Placed {
  Mat3<double> turn;
  Vec3<double> origin;  // [m]
};

struct Momentum {
  Vec3<double> linear, angular;  // inertial axes, about the system's centre of mass [N s, N m s]
};

struct Body {
  double mass;           // [kg]
  Vec3<double> lever;    // centre of mass in the joint frame [m]
  Mat3<double> inertia;  // about the centre of mass [kg m^2]
};

struct Joint {
  int parent;           // index of the parent joint; -1: the base
  bool turns;           // true: revolute, false: prismatic
  int own_axis;         // index of the frame axis parallel to the joint axis; -1: none
  Vec3<double> axis;    // unit vector in the joint frame
  Placed place;         // pose of the joint frame in the parent's frame
  bool moves_tip;       // true if the joint moves the end effector
  Body body;            // the body on the joint
  double carried_mass;  // mass of all bodies that the joint moves [kg]
};

struct Tree {
  int n;  // number of joints; a parent comes before its children
  Joint joints[kMostJoints];
  int last;                   // the joint that carries the end effector; -1: the base
  Placed tip;                 // pose of the end effector in the frame of the joint `last`
  double total_mass;          // [kg]
  Vec3<double> base_com;      // the base's centre of mass, root axes [m]
  Vec3<double> base_moment;   // the base's mass times base_com [kg m]
  Mat3<double> base_inertia;  // the base's inertia about the root's origin [kg m^2]
  bool moves, turns_freely;   // true if the base can translate, and if it can rotate, in the mode
  double inverse_mass;        // 1 / total_mass, or 0 if the base's position is held [1/kg]
};

// Computes the members that follow from the joints, the end effector, the mode and the base.
inline void complete(Tree& tree, const Body& base) {
  tree.total_mass = base.mass;
  tree.base_com = base.lever;
  tree.base_moment = base.mass * base.lever;
  tree.base_inertia = base.inertia;
  add_steiner(tree.base_inertia, base.mass, base.lever);
  for (int j = 0; j < tree.n; ++j) {
    Joint& joint = tree.joints[j];
    joint.own_axis = -1;
    for (int k = 0; k < 3; ++k) {
      if (std::fabs(joint.axis[k]) == 1.0) joint.own_axis = k;
    }
    tree.total_mass += joint.body.mass;
    joint.carried_mass = joint.body.mass;
    joint.moves_tip = false;
    for (int i = joint.parent; i >= 0; i = tree.joints[i].parent)
      tree.joints[i].carried_mass += joint.body.mass;
  }
  for (int i = tree.last; i >= 0; i = tree.joints[i].parent) tree.joints[i].moves_tip = true;
  tree.inverse_mass = tree.moves ? 1.0 / tree.total_mass : 0.0;
}

template <class T>
struct Arm {
  // Attitudes of the bodies and the end effector; origins of the joints, then the end effector.
  Mat3<T> rotation[kMostJoints], tip_rotation;
  Vec3<T> origin[kMostJoints + 1], tip;
  // Twists of the joints on a fixed base: angular velocity, and linear velocity at the origin.
  Vec3<T> axis[kMostJoints], velocity[kMostJoints];
  // First moment and inertia, about the origin, of all bodies that a joint moves.
  Vec3<T> moment[kMostJoints];
  Mat3<T> inertia[kMostJoints];
  // Momentum on a fixed base; the angular momentum is about the origin.
  Vec3<T> linear[kMostJoints], angular[kMostJoints];
  Vec3<T> com;      // centre of mass of the system, or of the base if the base's position is held
  Mat3<T> inverse;  // inverse of the system's inertia about com; zero if the attitude is held
  // Angular and linear velocity of the root of the floating base, from the momentum equation.
  Vec3<T> spin[kMostJoints], root[kMostJoints];
  // Columns of J_m (tip_) and of J*, linear and angular.
  Vec3<T> tip_velocity[kMostJoints], tip_spin[kMostJoints], jstar[kMostJoints], jstar_spin[kMostJoints];
  T coupling[6 * kMostJoints];  // C_bm (6, n), at the base's centre of mass
};

// Rotates an attitude about one of its own axes.
template <class T>
Mat3<T> turned(const Mat3<T>& placed, int axis, T sine, T cosine) {
  const int i = (axis + 1) % 3, j = (axis + 2) % 3;
  Mat3<T> out;
  for (int x = 0; x < 3; ++x) {
    out[x][axis] = placed[x][axis];
    out[x][i] = cosine * placed[x][i] + sine * placed[x][j];
    out[x][j] = cosine * placed[x][j] - sine * placed[x][i];
  }
  return out;
}

// Rotates an attitude about a unit vector in its own axes, by Rodrigues' formula with K = [axis]x:
// placed (1 + sin K + (1 - cos) K^2).
template <class T>
Mat3<T> turned(const Mat3<T>& placed, const Vec3<double>& axis, T sine, T cosine) {
  const Mat3<T> once = placed * skew(axis), twice = once * skew(axis);
  Mat3<T> out;
  for (int i = 0; i < 3; ++i) out[i] = placed[i] + sine * once[i] + (1.0 - cosine) * twice[i];
  return out;
}

// Computes attitudes, origins and twists of the joints on a fixed base, and the end effector's pose.
template <class T>
void pose(const Tree& tree, const T* positions, Arm<T>& arm) {
  const auto place = [&](int carrier, const Placed& there, Mat3<T>& rotation, Vec3<T>& origin) {
    rotation = carrier < 0 ? Mat3<T>(there.turn) : arm.rotation[carrier] * there.turn;
    origin = there.origin;
    if (carrier >= 0) origin = arm.rotation[carrier] * there.origin + arm.origin[carrier];
  };
  for (int j = 0; j < tree.n; ++j) {
    const Joint& joint = tree.joints[j];
    Mat3<T> placed;
    place(joint.parent, joint.place, placed, arm.origin[j]);
    const Vec3<T> direction = placed * joint.axis;
    if (!joint.turns) {
      arm.rotation[j] = placed;
      arm.origin[j] += positions[j] * direction;
      arm.axis[j] = {};
      arm.velocity[j] = direction;
      continue;
    }
    T s, c;
    sine_cosine(positions[j], s, c);
    const int own = joint.own_axis;
    arm.rotation[j] =
        own < 0 ? turned(placed, joint.axis, s, c) : turned(placed, own, s * joint.axis[own], c);
    arm.axis[j] = direction;
    arm.velocity[j] = cross(arm.origin[j], direction);
  }
  place(tree.last, tree.tip, arm.tip_rotation, arm.tip);
  arm.origin[tree.n] = arm.tip;
}

// Computes the first moments and inertias about the origin of all bodies that each joint moves, then `com`
// and `inverse` of Arm.
template <class T>
void carry(const Tree& tree, Arm<T>& arm) {
  for (int j = 0; j < tree.n; ++j) {
    const Body& body = tree.joints[j].body;
    const Vec3<T> centre = arm.origin[j] + arm.rotation[j] * body.lever;
    arm.moment[j] = body.mass * centre;
    arm.inertia[j] = arm.rotation[j] * body.inertia * transposed(arm.rotation[j]);
    add_steiner(arm.inertia[j], T(body.mass), centre);
  }
  Vec3<T> moment = tree.base_moment;
  Mat3<T> inertia = tree.base_inertia;
  for (int j = tree.n - 1; j >= 0; --j) {
    const int parent = tree.joints[j].parent;
    (parent < 0 ? moment : arm.moment[parent]) += arm.moment[j];
    (parent < 0 ? inertia : arm.inertia[parent]) += arm.inertia[j];
  }
  const Vec3<T> com = (1.0 / tree.total_mass) * moment;
  add_steiner(inertia, T(-tree.total_mass), com);
  arm.com = com;
  if (!tree.moves) {
    arm.com = tree.base_com;
    add_steiner(inertia, T(tree.total_mass), arm.com - com);
  }
  arm.inverse = tree.turns_freely ? inverse_symmetric(inertia) : Mat3<T>{};
}

// Computes the momentum at a unit rate of joint j, on a fixed base, about the origin.
template <class T>
void momentum(const Tree& tree, int j, Arm<T>& arm) {
  arm.linear[j] = tree.joints[j].carried_mass * arm.velocity[j] + cross(arm.axis[j], arm.moment[j]);
  arm.angular[j] = cross(arm.moment[j], arm.velocity[j]) + arm.inertia[j] * arm.axis[j];
}

// Computes the reaction of the base to a momentum of the arm: the angular velocity, and the root's velocity.
template <class T>
void react(const Tree& tree, const Arm<T>& arm, const Vec3<T>& linear, const Vec3<T>& angular, Vec3<T>& spin,
           Vec3<T>& root) {
  spin = arm.inverse * (cross(arm.com, linear) - angular);
  root = cross(arm.com, spin) - tree.inverse_mass * linear;
}

// Computes all values of Arm at joint positions (n).
template <class T>
void evaluate(const Tree& tree, const T* positions, Arm<T>& arm) {
  pose(tree, positions, arm);
  carry(tree, arm);
  const Vec3<T> base_com = tree.base_com;
  for (int j = 0; j < tree.n; ++j) {
    const bool moves_tip = tree.joints[j].moves_tip;
    momentum(tree, j, arm);
    react(tree, arm, arm.linear[j], arm.angular[j], arm.spin[j], arm.root[j]);
    arm.tip_velocity[j] = moves_tip ? arm.velocity[j] + cross(arm.axis[j], arm.tip) : Vec3<T>{};
    arm.tip_spin[j] = moves_tip ? arm.axis[j] : Vec3<T>{};
    arm.jstar[j] = arm.root[j] + cross(arm.spin[j], arm.tip) + arm.tip_velocity[j];
    arm.jstar_spin[j] = arm.spin[j] + arm.tip_spin[j];
    const Vec3<T> base = arm.root[j] - cross(base_com, arm.spin[j]);
    for (int x = 0; x < 3; ++x) {
      arm.coupling[x * tree.n + j] = base[x];
      arm.coupling[(3 + x) * tree.n + j] = arm.spin[j][x];
    }
  }
}

// Computes H_q (n, n) = H_m + H_bm^T C_bm.
//
// The entry (i, j) of H_m is the product of the twist of joint i and the momentum of all bodies that joint j
// moves, if joint i also moves these bodies (Featherstone's composite rigid bodies).
template <class T>
void reduced_inertia(const Tree& tree, const Arm<T>& arm, T* H) {
  const int n = tree.n;
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i)
      H[j * n + i] = dot(arm.linear[j], arm.root[i]) + dot(arm.angular[j], arm.spin[i]);
  }
  for (int j = 0; j < n; ++j) {
    for (int i = j; i >= 0; i = tree.joints[i].parent) {
      const T carried = dot(arm.axis[i], arm.angular[j]) + dot(arm.velocity[i], arm.linear[j]);
      H[i * n + j] += carried;
      if (i != j) H[j * n + i] += carried;
    }
  }
}

}  // namespace ffsms
