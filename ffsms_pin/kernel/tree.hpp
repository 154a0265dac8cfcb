// The robot in plain numbers: a base, and a tree of joints that turn or slide, each with the body it carries.
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

}  // namespace ffsms
