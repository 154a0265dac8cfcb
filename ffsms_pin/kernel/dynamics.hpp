// Torques of the joints, the base reacting, H_q u' + C_q, and what holds the base where a mode holds it.
//
// Seen from an inertial frame that moves along with the root's origin at the instant: an even velocity
// changes no force. Newton and Euler give the force on each body while the base is not accelerated; a joint
// bears that of all that it carries. The base then gives way in whatever is free of it. A joint's torque gets
// the base's twist a rate of the joint times the force on the whole: N^T f, where N^T M is zero in the base's
// columns. What is not free bears the force on the whole.
//
// Reference: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 5 and 9.
#pragma once

#include "slopes.hpp"

namespace ffsms {

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
