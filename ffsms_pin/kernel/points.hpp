// The paper's clearances of points at one configuration: pairs of them, and points outside the base's box.
#pragma once

#include <cmath>
#include <cstdint>

#include "arm.hpp"

namespace ffsms {

// The box of the base: its axes are the columns of the rotation.
struct Box {
  Mat3<double> rotation;
  Vec3<double> centre, half;
};

// How far a point is outside a box, and the direction in which that grows: beyond the face that it is
// furthest beyond.
inline double outside(const Box& box, const Vec3<double>& point, Vec3<double>& normal) {
  const Vec3<double> place = transposed(box.rotation) * (point - box.centre);
  int face = 0;
  for (int i = 1; i < 3; ++i) {
    if (std::fabs(place[i]) - box.half[i] > std::fabs(place[face]) - box.half[face]) face = i;
  }
  const double side = place[face] < 0.0 ? -1.0 : 1.0;
  for (int x = 0; x < 3; ++x) normal[x] = side * box.rotation[x][face];
  return std::fabs(place[face]) - box.half[face];
}

// Distances (m) and their gradients (m, n) by the joints, base held still. Points are the joints' origins,
// then the end effector; what a point is apart from is another point, or the box (-1). `moves` and `holds`
// (m, n) are 1 where a joint carries the one, and the other.
inline void point_clearances(const Tree& tree, const Arm<double>& arm, const std::int64_t* there,
                             const std::int64_t* here, const double* moves, const double* holds,
                             const Box& box, int count, double* distance, double* gradient) {
  const auto point = [&](std::int64_t i) { return i < tree.n ? arm.origin[i] : arm.tip; };
  for (int m = 0; m < count; ++m) {
    const Vec3<double> end = point(there[m]);
    Vec3<double> start = zero3<double>(), normal;
    if (here[m] < 0) {
      distance[m] = outside(box, end, normal);
    } else {
      start = point(here[m]);
      const Vec3<double> apart = end - start;
      distance[m] = std::sqrt(dot(apart, apart));
      normal = (1.0 / std::fmax(distance[m], 1e-12)) * apart;
    }
    for (int j = 0; j < tree.n; ++j) {
      const int at = m * tree.n + j;
      const Vec3<double>&axis = arm.axis[j], velocity = arm.velocity[j];
      gradient[at] = moves[at] * dot(normal, velocity + cross(axis, end)) -
                     holds[at] * dot(normal, velocity + cross(axis, start));
    }
  }
}

}  // namespace ffsms
