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

// A convex part: all that is no further than so much from the hull of its corners, in its body's axes.
struct Corners {
  const Vec3<double>* begin;
  std::int64_t count;
  double round;

  const Vec3<double>& furthest(const Vec3<double>& way) const {
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
    return *best;
  }
};

struct Gap {
  double least, most;
};

// Bounds on the distance of two convex parts: a gap along a direction, which is improved from that of the
// time before towards the nearest that is found of the difference of the parts. It ends where they are at
// least `near` apart, or surely nearer and the bound from below is no less than a share of that from above.
inline Gap gap(const Corners& one, const Corners& other, const Placed& seen, double near, double share,
               Vec3<double>& way) {
  constexpr int kTries = 12;
  const double round = one.round + other.round;
  const Mat3<double> back = transposed(seen.turn);
  Gap found = {-kInfinity, kInfinity};
  Vec3<double> v = zero3<double>();
  for (int tried = 0; tried < kTries; ++tried) {
    const Vec3<double>& a = one.furthest(way);
    const Vec3<double>& b = other.furthest(-1.0 * (back * way));
    const Vec3<double> w = seen.origin + seen.turn * b - a;
    found.least = std::max(found.least, dot(way, w) - round);
    if (found.least >= near) break;
    if (tried == 0) v = w;
    const Vec3<double> change = v - w;
    const double square = dot(change, change);
    // The point of the way from v to w that is the nearest to the origin.
    const double part = square > 0.0 ? std::min(std::max(dot(v, change) / square, 0.0), 1.0) : 0.0;
    v = v - part * change;
    const double size = std::sqrt(dot(v, v));
    found.most = std::min(found.most, size - round);
    if (found.most <= 0.0 || (found.most < near && found.least >= share * found.most)) break;
    way = (1.0 / size) * v;
  }
  return found;
}

}  // namespace ffsms
