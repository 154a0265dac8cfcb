// Nearest points of the paper's clearances, and how distances change with the joints.
#pragma once

#include "arm.hpp"
#include "clearance.hpp"

namespace ffsms {

// The box of the base: its axes are the columns of the rotation.
struct Box {
  Mat3<double> rotation;
  Vec3<double> centre, half;
};

// How far a point is outside a box: beyond the face that it is furthest beyond.
inline double from_box(const Box& box, Nearest& found) {
  const Vec3<double> place = transposed(box.rotation) * (found.there - box.centre);
  int face = 0;
  for (int i = 1; i < 3; ++i) {
    if (std::fabs(place[i]) - box.half[i] > std::fabs(place[face]) - box.half[face]) face = i;
  }
  const double side = place[face] < 0.0 ? -1.0 : 1.0;
  for (int x = 0; x < 3; ++x) found.normal[x] = side * box.rotation[x][face];
  return std::fabs(place[face]) - box.half[face];
}

// How far a point is from another one.
inline double from_point(Nearest& found) {
  constexpr double kLeast = 1e-12;  // [m] nearer than this there is no direction from one to the other
  const Vec3<double> apart = found.there - found.here;
  const double distance = std::sqrt(dot(apart, apart));
  found.normal = (1.0 / std::fmax(distance, kLeast)) * apart;
  return distance;
}

// Adds to the gradient (n), `stride` apart, what the joints that carry a body do to a distance by moving a
// point of it; `side` is 1 for the second of two bodies and -1 for the first, base held still.
inline void add_slopes(const Tree& tree, const Arm<double>& arm, std::int64_t body, const Vec3<double>& point,
                       const Vec3<double>& normal, double side, double* gradient, std::int64_t stride) {
  if (body >= tree.n) return;  // no joint moves an obstacle
  for (auto j = static_cast<int>(body); j >= 0; j = tree.joints[j].parent)
    gradient[j * stride] += side * dot(normal, arm.velocity[j] + cross(arm.axis[j], point));
}

}  // namespace ffsms
