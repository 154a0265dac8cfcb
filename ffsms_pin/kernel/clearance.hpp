// Distances between convex parts of bodies: bounds by balls and boxes, and what is measured beyond these.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "arm.hpp"

namespace ffsms {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Nearest points of two things, and the direction along which the distance grows when the second moves.
struct Nearest {
  Vec3<double> here, there, normal;
};

// A ball and a box of one centre around something that is fixed to a body, in the body's axes.
struct Cover {
  double body;  // the joint that carries it, -1: the base; obstacles come after the joints
  Vec3<double> centre;
  double radius;
  Vec3<double> half;  // of the box's sides
  Mat3<double> axes;  // of the box, as columns
};
static_assert(sizeof(Cover) == 17 * sizeof(double), "Python hands covers over as rows of 17 numbers");

// How far a ball, whose centre is `way` from the box's, is outside the box.
inline double outside(const Cover& box, const Vec3<double>& way, double radius) {
  const Vec3<double> along = transposed(box.axes) * way;
  Vec3<double> far;
  for (int i = 0; i < 3; ++i) far[i] = std::max(std::fabs(along[i]) - box.half[i], 0.0);
  // A ball whose centre is in the box may be deeper in it than its radius.
  return dot(far, far) > 0.0 ? std::sqrt(dot(far, far)) - radius : -kInfinity;
}

// A bound from below on the distance of two things, a better one where it is below `near`; the second body is
// `seen` by the first.
inline double bound(const Cover& one, const Cover& other, const Placed& seen, double near) {
  const Vec3<double> way = seen.origin + seen.turn * other.centre - one.centre;
  double least = std::sqrt(dot(way, way)) - one.radius - other.radius;
  if (least < near) least = std::max(least, outside(one, way, other.radius));
  if (least < near) least = std::max(least, outside(other, transposed(seen.turn) * way, one.radius));
  return least;
}

// A convex part in its body's axes: all that is no further than `ball` from the hull of its corners, each
// with a disc across `axis` around it.
struct Hull {
  const Vec3<double>* begin;
  std::int64_t count;  // a multiple of four
  double ball, disc;
  Vec3<double> axis;

  Vec3<double> furthest(const Vec3<double>& way) const {
    const Vec3<double>* best = begin;
    double most = -kInfinity;
    for (const Vec3<double>* x = begin; x != begin + count; x += 4) {
      const double a = dot(way, x[0]), b = dot(way, x[1]), c = dot(way, x[2]), d = dot(way, x[3]);
      const double ab = a > b ? a : b, cd = c > d ? c : d, m = ab > cd ? ab : cd;
      if (m > most) best = m == a ? x : m == b ? x + 1 : m == c ? x + 2 : x + 3;
      most = m > most ? m : most;
    }
    const Vec3<double> across = way - dot(way, axis) * axis;
    const double size = std::sqrt(dot(across, across));
    return disc > 0.0 && size > 0.0 ? *best + (disc / size) * across : *best;
  }
};

// Points of the difference of two parts, second less first, and the point of their hull that is the nearest
// to the origin, with weights.
struct Simplex {
  int count = 0;
  Vec3<double> here[4], apart[4], nearest;
  double weight[4];

  // Adds a point, which the face with the nearest point has then, and leaves out those that are not of it.
  void add(const Vec3<double>& a, const Vec3<double>& w) {
    double least = kInfinity, best[4] = {};
    here[count] = a;
    apart[count] = w;
    for (int face = 0; face < 1 << count; ++face) {
      // Edges of the face from the new point, orthogonal to which the nearest point is; others are zero.
      Vec3<double> edge[3], gram[3], side, part;
      for (int i = 0; i < 3; ++i) {
        edge[i] = face >> i & 1 ? apart[i] - w : Vec3<double>{};
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
      here[count] = here[i];
      apart[count] = apart[i];
      weight[count++] = best[i];
    }
  }
};

struct Gap {
  double least, most;
  Nearest found;
};

// The distance of two convex parts by the algorithm of Gilbert, Johnson and Keerthi: bounds from below and
// from above, which meet unless the parts overlap, or are surely `stop` apart, or one has no corners. `way`:
// a direction along which they may be apart, or zero, and then a better one.
inline Gap gap(const Hull& one, const Hull& other, const Placed& seen, double stop, Vec3<double>& way) {
  constexpr int kTries = 64;
  constexpr double kRounding = 1e-12, kTouching = 1e-9;  // [m]
  const double round = one.ball + other.ball;
  const Mat3<double> back = transposed(seen.turn);
  Simplex simplex;
  Gap gap = {-kInfinity, kInfinity, {}};
  if (one.count == 0 || other.count == 0) return gap;
  if (dot(way, way) == 0.0) way = {{1.0, 0.0, 0.0}};
  double size = kInfinity;
  for (int tried = 0; tried < kTries; ++tried) {
    const Vec3<double> a = one.furthest(way), b = other.furthest(-1.0 * (back * way));
    const Vec3<double> w = seen.origin + seen.turn * b - a;
    gap.least = std::max(gap.least, dot(way, w) - round);
    if (gap.least >= stop || gap.least >= gap.most - kRounding) break;
    simplex.add(a, w);
    const double before = size;
    size = std::sqrt(dot(simplex.nearest, simplex.nearest));
    if (!(size > kTouching && size < before)) break;
    gap.most = size - round;
    way = (1.0 / size) * simplex.nearest;
  }
  gap.found = {one.ball * way, Vec3<double>{}, way};
  for (int i = 0; i < simplex.count; ++i) gap.found.here += simplex.weight[i] * simplex.here[i];
  gap.found.there = gap.found.here + gap.most * way;
  return gap;
}

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
