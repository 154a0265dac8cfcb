// The robot in plain numbers, a base and a tree of joints that turn or slide, each with the body it carries;
// kinematics and momentum of the arm at one configuration, or at one configuration a lane.
//
// Everything is in base axes with the root's origin at zero, and so depends on the joints alone. A column j
// belongs to a unit rate of joint j.
#pragma once

#include "vec3.hpp"

namespace ffsms {

constexpr int kMostJoints = 64;

struct Joint {
  int parent;              // index of the joint before it; -1: the base
  bool turns;              // or slides
  int own_axis;            // which axis of its own frame it turns about; -1: none of them
  Mat3<double> placement;  // of its frame in its parent's: rotation
  Vec3<double> offset;     // and origin [m]
  Vec3<double> axis;       // of unit length, in its own frame
  bool moves_tip;          // whether it carries the end effector
  double mass;             // of its body [kg]
  Vec3<double> lever;      // to the body's centre of mass, in its own frame [m]
  Mat3<double> inertia;    // about that [kg m^2]
  double carried_mass;     // of all that it carries [kg]
};

struct Tree {
  int n;  // number of joints, parents first
  Joint joints[kMostJoints];
  int last;                  // the joint that carries the end effector; -1: the base
  Vec3<double> tip_in_last;  // the end effector's place and attitude there
  Mat3<double> tip_turn;
  double total_mass;          // [kg]
  Vec3<double> base_com;      // in root axes [m]
  Vec3<double> base_moment;   // the base's mass times that [kg m]
  Mat3<double> base_inertia;  // of the base about the root's origin [kg m^2]
  // What a mode holds reacts like infinite mass, or infinite inertia.
  bool moves, turns_freely;
  double inverse_mass;  // of what a force on the base moves; 0 where its place is held [1/kg]
};

template <class T>
struct Arm {
  Mat3<T> rotation[kMostJoints];  // of the bodies
  Vec3<T> origin[kMostJoints];
  Vec3<T>
      axis[kMostJoints];  // twist of the joints on a fixed base: angular, linear of the point at the origin
  Vec3<T> velocity[kMostJoints];
  Vec3<T> moment[kMostJoints];  // of all that a joint carries, about the origin: first moment, inertia
  Mat3<T> inertia[kMostJoints];
  Vec3<T> linear[kMostJoints];  // momentum on a fixed base, angular about the origin
  Vec3<T> angular[kMostJoints];
  Vec3<T> com;                // of the system; where the base's place is held, the base's own
  Mat3<T> inverse;            // of the inertia about that; zero where the attitude is held
  Vec3<T> spin[kMostJoints];  // of the root of the floating base: the momentum equation
  Vec3<T> root[kMostJoints];
  Vec3<T> tip;
  Mat3<T> tip_rotation;
  Vec3<T> tip_velocity[kMostJoints];  // on a fixed base
  Vec3<T> jstar[kMostJoints];         // the base reacting: linear rows of J*
  T coupling[6][kMostJoints];         // C_bm, of the base's centre of mass
};

// Turned about one of its own axes.
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

// Turned about any axis: Rodrigues' formula, placed (1 + sin K + (1 - cos) K^2).
template <class T>
Mat3<T> turned(const Mat3<T>& placed, const Vec3<double>& axis, T sine, T cosine) {
  const Mat3<double> K = {{{0.0, -axis[2], axis[1]}, {axis[2], 0.0, -axis[0]}, {-axis[1], axis[0], 0.0}}};
  const Mat3<T> once = placed * K, twice = once * K;
  Mat3<T> out;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[i][j] = placed[i][j] + sine * once[i][j] + (1.0 - cosine) * twice[i][j];
  }
  return out;
}

// Rotations, origins and twists of the joints on a fixed base.
template <class T>
void pose(const Tree& tree, const T* positions, Arm<T>& arm) {
  for (int j = 0; j < tree.n; ++j) {
    const Joint& joint = tree.joints[j];
    Mat3<T> placed;
    Vec3<T> origin;
    if (joint.parent < 0) {
      placed = same<T>(joint.placement);
      origin = same<T>(joint.offset);
    } else {
      placed = arm.rotation[joint.parent] * joint.placement;
      origin = arm.rotation[joint.parent] * joint.offset + arm.origin[joint.parent];
    }
    const Vec3<T> direction = placed * joint.axis;
    if (!joint.turns) {
      arm.rotation[j] = placed;
      arm.origin[j] = origin + positions[j] * direction;
      arm.axis[j] = zero3<T>();
      arm.velocity[j] = direction;
      continue;
    }
    T s, c;
    sine_cosine(positions[j], s, c);
    if (joint.own_axis >= 0) {
      arm.rotation[j] = turned(placed, joint.own_axis, s * joint.axis[joint.own_axis], c);
    } else {
      arm.rotation[j] = turned(placed, joint.axis, s, c);
    }
    arm.origin[j] = origin;
    arm.axis[j] = direction;
    arm.velocity[j] = cross(origin, direction);
  }
}

// First moments and inertias about the origin: of the bodies, then of all that a joint carries, then of all.
template <class T>
void carry(const Tree& tree, Arm<T>& arm) {
  for (int j = 0; j < tree.n; ++j) {
    const Joint& joint = tree.joints[j];
    const Vec3<T> centre = arm.origin[j] + arm.rotation[j] * joint.lever;
    arm.moment[j] = joint.mass * centre;
    arm.inertia[j] = arm.rotation[j] * joint.inertia * transposed(arm.rotation[j]);
    add_steiner(arm.inertia[j], T(joint.mass), centre);
  }
  Vec3<T> moment = same<T>(tree.base_moment);
  Mat3<T> inertia = same<T>(tree.base_inertia);
  for (int j = tree.n - 1; j >= 0; --j) {
    const int parent = tree.joints[j].parent;
    (parent < 0 ? moment : arm.moment[parent]) += arm.moment[j];
    (parent < 0 ? inertia : arm.inertia[parent]) += arm.inertia[j];
  }
  const Vec3<T> com = (1.0 / tree.total_mass) * moment;
  add_steiner(inertia, T(-tree.total_mass), com);
  arm.com = com;
  if (!tree.moves) {
    arm.com = same<T>(tree.base_com);
    add_steiner(inertia, T(tree.total_mass), arm.com - com);
  }
  arm.inverse = tree.turns_freely ? inverse_symmetric(inertia) : Mat3<T>{};
}

// Momentum of a joint at unit rate, on a fixed base, about the origin.
template <class T>
void momentum(const Tree& tree, int j, Arm<T>& arm) {
  arm.linear[j] = tree.joints[j].carried_mass * arm.velocity[j] + cross(arm.axis[j], arm.moment[j]);
  arm.angular[j] = cross(arm.moment[j], arm.velocity[j]) + arm.inertia[j] * arm.axis[j];
}

// How the base reacts to momenta of the arm: its angular velocity, and its root's linear one.
template <class T>
void react(const Tree& tree, const Arm<T>& arm, const Vec3<T>& linear, const Vec3<T>& angular, Vec3<T>& spin,
           Vec3<T>& root) {
  spin = arm.inverse * (cross(arm.com, linear) - angular);
  root = cross(arm.com, spin) - tree.inverse_mass * linear;
}

// All of it at joint positions (n).
template <class T>
void evaluate(const Tree& tree, const T* positions, Arm<T>& arm) {
  pose(tree, positions, arm);
  carry(tree, arm);
  if (tree.last < 0) {
    arm.tip = same<T>(tree.tip_in_last);
    arm.tip_rotation = same<T>(tree.tip_turn);
  } else {
    arm.tip = arm.origin[tree.last] + arm.rotation[tree.last] * tree.tip_in_last;
    arm.tip_rotation = arm.rotation[tree.last] * tree.tip_turn;
  }
  const Vec3<T> base_com = same<T>(tree.base_com);
  for (int j = 0; j < tree.n; ++j) {
    const Joint& joint = tree.joints[j];
    const Vec3<T>&axis = arm.axis[j], &velocity = arm.velocity[j];
    momentum(tree, j, arm);
    react(tree, arm, arm.linear[j], arm.angular[j], arm.spin[j], arm.root[j]);
    const Vec3<T> moved = velocity + cross(axis, arm.tip);
    arm.tip_velocity[j] = joint.moves_tip ? moved : zero3<T>();
    arm.jstar[j] = arm.root[j] + cross(arm.spin[j], arm.tip) + arm.tip_velocity[j];
    const Vec3<T> base = arm.root[j] - cross(base_com, arm.spin[j]);
    for (int x = 0; x < 3; ++x) {
      arm.coupling[x][j] = base[x];
      arm.coupling[3 + x][j] = arm.spin[j][x];
    }
  }
}

// H_q (n, n): H_m less what the base's reaction takes away, H_m + H_bm^T C_bm.
//
// H_m is the twist of joint i on the momentum of all that joint j carries, where i carries j too
// (Featherstone's composite rigid bodies).
template <class T>
void reduced_inertia(const Tree& tree, const Arm<T>& arm, T (*H)[kMostJoints]) {
  for (int j = 0; j < tree.n; ++j) {
    for (int i = 0; i < tree.n; ++i)
      H[j][i] = dot(arm.linear[j], arm.root[i]) + dot(arm.angular[j], arm.spin[i]);
  }
  for (int j = 0; j < tree.n; ++j) {
    for (int i = j; i >= 0; i = tree.joints[i].parent) {
      const T carried = dot(arm.axis[i], arm.angular[j]) + dot(arm.velocity[i], arm.linear[j]);
      H[i][j] += carried;
      if (i != j) H[j][i] += carried;
    }
  }
}

}  // namespace ffsms
