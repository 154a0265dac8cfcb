// Distances between convex parts of bodies: bounds by balls and boxes, and exact distances.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "arm.hpp"

namespace ffsms {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The nearest points on the first and second body, and the unit normal. The distance grows fastest if the
// second body moves along the normal.
struct Nearest {
  Vec3<double> on_first, on_second, normal;
};

// A bounding ball and a bounding box with the same centre, in the axes of the body that carries them.
struct Cover {
  double body;  // index of the body's joint; -1: the base; from n on: obstacles
  Vec3<double> centre;
  double radius;
  Vec3<double> half;  // half the box's sides
  Mat3<double> axes;  // the box's axes, as columns
};
static_assert(sizeof(Cover) == 17 * sizeof(double), "Python passes covers as rows of 17 numbers");

// Returns the distance of a ball from the box, or minus infinity if the ball's centre is in the box.
// `displacement` is the vector from the box's centre to the ball's centre.
inline double outside(const Cover& box, const Vec3<double>& displacement, double radius) {
  const Vec3<double> along = transposed(box.axes) * displacement;
  Vec3<double> far;
  for (int i = 0; i < 3; ++i) far[i] = std::max(std::fabs(along[i]) - box.half[i], 0.0);
  // A ball whose centre is in the box may be deeper in it than its radius.
  return dot(far, far) > 0.0 ? std::sqrt(dot(far, far)) - radius : -kInfinity;
}

// Returns a lower bound of the distance of two covers: the distance of the balls or, if it is below `near`,
// the largest of this distance and the distances of each ball from the other cover's box. `relative` is the
// pose of the second body relative to the first.
inline double bound(const Cover& first, const Cover& second, const Placed& relative, double near) {
  const Vec3<double> displacement = relative.origin + relative.turn * second.centre - first.centre;
  double least = std::sqrt(dot(displacement, displacement)) - first.radius - second.radius;
  if (least < near) least = std::max(least, outside(first, displacement, second.radius));
  if (least < near)
    least = std::max(least, outside(second, transposed(relative.turn) * displacement, first.radius));
  return least;
}

// A convex part in its body's axes: the hull of its corners, with a disc of radius `disc` normal to `axis`
// around each corner, enlarged by a ball of radius `ball`.
struct Hull {
  const Vec3<double>* begin;
  std::int64_t count;  // a multiple of four
  double ball, disc;
  Vec3<double> axis;

  Vec3<double> support(const Vec3<double>& direction) const {
    const Vec3<double>* best = begin;
    double most = -kInfinity;
    for (const Vec3<double>* x = begin; x != begin + count; x += 4) {
      const double a = dot(direction, x[0]), b = dot(direction, x[1]), c = dot(direction, x[2]),
                   d = dot(direction, x[3]);
      const double ab = a > b ? a : b, cd = c > d ? c : d, m = ab > cd ? ab : cd;
      if (m > most) best = m == a ? x : m == b ? x + 1 : m == c ? x + 2 : x + 3;
      most = m > most ? m : most;
    }
    const Vec3<double> across = direction - dot(direction, axis) * axis;
    const double size = std::sqrt(dot(across, across));
    return disc > 0.0 && size > 0.0 ? *best + (disc / size) * across : *best;
  }
};

// The simplex of the algorithm of Gilbert, Johnson and Keerthi. `difference` are points of the Minkowski
// difference of two parts (second minus first), and `on_first` are the corresponding points of the first
// part. `nearest` is the point of the hull of `difference` nearest to the origin, the sum of `difference`
// with the weights `weight`.
struct Simplex {
  int count = 0;
  Vec3<double> on_first[4], difference[4], nearest;
  double weight[4];

  // Adds a point and keeps only the points of the face that contains the nearest point.
  void add(const Vec3<double>& a, const Vec3<double>& w) {
    double least = kInfinity, best[4] = {};
    on_first[count] = a;
    difference[count] = w;
    for (int face = 0; face < 1 << count; ++face) {
      // The edges of the face from the new point; an edge to a point that is not on the face is zero. The
      // vector to the nearest point is orthogonal to all edges.
      Vec3<double> edge[3], gram[3], side, part;
      for (int i = 0; i < 3; ++i) {
        edge[i] = face >> i & 1 ? difference[i] - w : Vec3<double>{};
        side[i] = -dot(edge[i], w);
        for (int j = 0; j <= i; ++j) gram[i][j] = gram[j][i] = dot(edge[i], edge[j]);
        if (!(face >> i & 1)) gram[i][i] = 1.0;
      }
      const double volume = dot(gram[0], cross(gram[1], gram[2]));
      if (!(volume > 0.0)) continue;
      for (int i = 0; i < 3; ++i) part[i] = dot(side, cross(gram[(i + 1) % 3], gram[(i + 2) % 3])) / volume;
      const double rest = 1.0 - part[0] - part[1] - part[2];
      if (std::min({part[0], part[1], part[2], rest}) < 0.0) continue;
      const Vec3<double> v = w + part[0] * edge[0] + part[1] * edge[1] + part[2] * edge[2];
      if (!(dot(v, v) < least)) continue;
      least = dot(v, v);
      nearest = v;
      std::copy_n(part.v, 3, best);
      best[count] = rest;
    }
    const int all = count + 1;
    count = 0;
    for (int i = 0; i < all; ++i) {
      if (best[i] == 0.0) continue;
      on_first[count] = on_first[i];
      difference[count] = difference[i];
      weight[count++] = best[i];
    }
  }
};

struct Gap {
  double lower, upper;  // bounds of the distance [m]
  Nearest nearest;
};

// Returns bounds of the distance of two convex parts by the algorithm of Gilbert, Johnson and Keerthi. The
// bounds are equal to rounding unless the parts overlap, are at least `stop` apart, or one part has no
// corners. `direction` is an initial guess of a separating unit vector, or zero; the result replaces it.
inline Gap gap(const Hull& first, const Hull& second, const Placed& relative, double stop,
               Vec3<double>& direction) {
  constexpr int kIterations = 64;
  constexpr double kRounding = 1e-12, kTouching = 1e-9;  // [m]
  const double round = first.ball + second.ball;
  const Mat3<double> back = transposed(relative.turn);
  Simplex simplex;
  Gap gap = {-kInfinity, kInfinity, {}};
  if (first.count == 0 || second.count == 0) return gap;
  if (dot(direction, direction) == 0.0) direction = {{1.0, 0.0, 0.0}};
  double size = kInfinity;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const Vec3<double> a = first.support(direction), b = second.support(-1.0 * (back * direction));
    const Vec3<double> w = relative.origin + relative.turn * b - a;
    gap.lower = std::max(gap.lower, dot(direction, w) - round);
    if (gap.lower >= stop || gap.lower >= gap.upper - kRounding) break;
    simplex.add(a, w);
    const double before = size;
    size = std::sqrt(dot(simplex.nearest, simplex.nearest));
    if (!(size > kTouching && size < before)) break;
    gap.upper = size - round;
    direction = (1.0 / size) * simplex.nearest;
  }
  gap.nearest = {first.ball * direction, Vec3<double>{}, direction};
  for (int i = 0; i < simplex.count; ++i) gap.nearest.on_first += simplex.weight[i] * simplex.on_first[i];
  gap.nearest.on_second = gap.nearest.on_first + gap.upper * direction;
  return gap;
}

// The box of the base; its axes are the columns of the rotation.
struct Box {
  Mat3<double> rotation;
  Vec3<double> centre, half;
};

// Returns the signed distance of the point `on_second` from a face of a box, negative inside, and sets the
// normal to that of the face. The face is the one with the largest signed distance.
inline double from_box(const Box& box, Nearest& nearest) {
  const Vec3<double> place = transposed(box.rotation) * (nearest.on_second - box.centre);
  int face = 0;
  for (int i = 1; i < 3; ++i) {
    if (std::fabs(place[i]) - box.half[i] > std::fabs(place[face]) - box.half[face]) face = i;
  }
  const double side = place[face] < 0.0 ? -1.0 : 1.0;
  for (int x = 0; x < 3; ++x) nearest.normal[x] = side * box.rotation[x][face];
  return std::fabs(place[face]) - box.half[face];
}

// Returns the distance of the points `on_first` and `on_second`, and sets the normal to the direction between
// them.
inline double from_point(Nearest& nearest) {
  constexpr double kLeast = 1e-12;  // [m] below this distance the normal is not a unit vector
  const Vec3<double> difference = nearest.on_second - nearest.on_first;
  const double distance = std::sqrt(dot(difference, difference));
  nearest.normal = (1.0 / std::fmax(distance, kLeast)) * difference;
  return distance;
}

// Adds the part of a distance's gradient by the joint positions that is due to the motion of a point of a
// body on a fixed base. The n entries of `gradient` are `stride` doubles apart. `side` is 1 for the second
// body of the pair and -1 for the first.
inline void add_slopes(const Tree& tree, const Arm<double>& arm, std::int64_t body, const Vec3<double>& point,
                       const Vec3<double>& normal, double side, double* gradient, std::int64_t stride) {
  if (body >= tree.n) return;  // an obstacle, which no joint moves
  for (auto j = static_cast<int>(body); j >= 0; j = tree.joints[j].parent)
    gradient[j * stride] += side * dot(normal, arm.velocity[j] + cross(arm.axis[j], point));
}

}  // namespace ffsms
