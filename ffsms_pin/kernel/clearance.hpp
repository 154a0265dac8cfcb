// Bounds on distances between convex parts of bodies: balls, boxes, and directions along which they are
// apart.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "vec3.hpp"

namespace ffsms {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A ball and a box of one centre around something that is fixed to a body, in the body's axes.
struct Cover {
  double body;  // the joint that carries it, -1: the base; obstacles come after the joints
  Vec3<double> centre;
  double radius;
  Vec3<double> half;  // of the box's sides
  Mat3<double> axes;  // of the box, as columns
};
static_assert(sizeof(Cover) == 17 * sizeof(double), "Python hands covers over as rows of 17 numbers");

// Nearest points of two things, and the direction along which the distance grows when the second moves.
struct Nearest {
  Vec3<double> here, there, normal;
};

struct Placed {
  Mat3<double> turn;
  Vec3<double> origin;
};

// The second body as the first sees it.
inline Placed seen_from(const Placed& first, const Placed& second) {
  const Mat3<double> back = transposed(first.turn);
  return {back * second.turn, back * (second.origin - first.origin)};
}

// How far a ball, whose centre is `way` from the box's, is outside the box.
inline double outside(const Cover& box, const Vec3<double>& way, double radius) {
  const Vec3<double> along = transposed(box.axes) * way;
  double square = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double far = std::max(std::fabs(along[i]) - box.half[i], 0.0);
    square += far * far;
  }
  // A ball whose centre is in the box may be deeper in it than its radius.
  return square > 0.0 ? std::sqrt(square) - radius : -kInfinity;
}

// A bound from below on the distance of two things, a better one where it is below `near`.
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
  std::int64_t count;
  double ball, disc;
  Vec3<double> axis;

  Vec3<double> furthest(const Vec3<double>& way) const {
    const Vec3<double>* best = begin;
    double most = -kInfinity;
    const Vec3<double>* x = begin;
    for (; x + 4 <= begin + count; x += 4) {
      const double a = dot(way, x[0]), b = dot(way, x[1]), c = dot(way, x[2]), d = dot(way, x[3]);
      const double ab = a > b ? a : b, cd = c > d ? c : d, m = ab > cd ? ab : cd;
      if (m > most) {
        most = m;
        best = m == a ? x : m == b ? x + 1 : m == c ? x + 2 : x + 3;
      }
    }
    for (; x != begin + count; ++x) {
      const double along = dot(way, *x);
      if (along > most) {
        most = along;
        best = x;
      }
    }
    if (disc == 0.0) return *best;
    const Vec3<double> across = way - dot(way, axis) * axis;
    const double size = std::sqrt(dot(across, across));
    return size > 0.0 ? *best + (disc / size) * across : *best;
  }
};

// Points of the difference of two parts, second less first, and the point of their hull that is the nearest
// to the origin, with weights.
struct Simplex {
  int count = 0;
  Vec3<double> here[4], apart[4];
  double weight[4];
  Vec3<double> nearest;

  // Adds a point, which the face with the nearest point has then, and leaves out those that are not of it.
  void add(const Vec3<double>& a, const Vec3<double>& w) {
    here[count] = a;
    apart[count] = w;
    double least = kInfinity, best[4] = {};
    for (int face = 0; face < 1 << count; ++face) {
      // The edges of the face from the new point, orthogonal to which the nearest point is; zero are others.
      Vec3<double> edge[3], gram[3], side = zero3<double>();
      for (int i = 0; i < 3; ++i) {
        edge[i] = face >> i & 1 ? apart[i] - w : zero3<double>();
        side[i] = -dot(edge[i], w);
      }
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) gram[i][j] = dot(edge[i], edge[j]) + (i == j && !(face >> i & 1));
      }
      const Vec3<double> across = cross(gram[1], gram[2]);
      const double volume = dot(gram[0], across);
      if (!(volume > 0.0)) continue;
      const double part[3] = {dot(side, across) / volume, dot(side, cross(gram[2], gram[0])) / volume,
                              dot(side, cross(gram[0], gram[1])) / volume};
      if (std::min({part[0], part[1], part[2], 1.0 - part[0] - part[1] - part[2]}) < 0.0) continue;
      const Vec3<double> v = w + part[0] * edge[0] + part[1] * edge[1] + part[2] * edge[2];
      const double square = dot(v, v);
      if (!(square < least)) continue;
      least = square;
      nearest = v;
      std::fill_n(best, 4, 0.0);
      for (int i = 0; i < count; ++i) best[i] = part[i];
      best[count] = 1.0 - part[0] - part[1] - part[2];
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
// from above, which meet unless the parts overlap, or are surely `stop` apart. `way`: a direction along which
// they may be apart, and one that is better.
inline Gap gap(const Hull& one, const Hull& other, const Placed& seen, double stop, Vec3<double>& way) {
  constexpr int kTries = 64;
  constexpr double kRounding = 1e-12, kTouching = 1e-9;  // [m]
  const double round = one.ball + other.ball;
  const Mat3<double> back = transposed(seen.turn);
  Simplex simplex;
  Gap gap = {-kInfinity, kInfinity, {}};
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
  gap.found = {one.ball * way, zero3<double>(), way};
  for (int i = 0; i < simplex.count; ++i) gap.found.here += simplex.weight[i] * simplex.here[i];
  gap.found.there = gap.found.here + gap.most * way;
  return gap;
}

}  // namespace ffsms
