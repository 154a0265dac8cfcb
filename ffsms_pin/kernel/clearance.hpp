// Bounds from below on distances between parts of bodies: balls, and a ball against a box.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

namespace ffsms {

// A ball and a box of one centre around something that is fixed to a body, in the body's axes.
struct Cover {
  double body;  // an index, counted from the end where it is negative
  double centre[3], radius, half[3];
  double axes[9];  // of the box, as columns
};
static_assert(sizeof(Cover) == 17 * sizeof(double), "Python hands covers over as rows of 17 numbers");

// Attitudes (3, 3, bodies, count) and places (3, bodies, count) of bodies at many configurations.
struct Bodies {
  const double *rotations, *origins;
  std::int64_t bodies, count;

  double rotation(int row, int column, std::int64_t body, std::int64_t at) const {
    return rotations[((3 * row + column) * bodies + body) * count + at];
  }
  double origin(int row, std::int64_t body, std::int64_t at) const {
    return origins[(row * bodies + body) * count + at];
  }
  std::int64_t index(const Cover& cover) const {
    const auto body = static_cast<std::int64_t>(cover.body);
    return body < 0 ? body + bodies : body;
  }
};

// The second body as the first sees it.
struct Relative {
  double turn[9], way[3];

  Relative(const Bodies& seen, std::int64_t first, std::int64_t second, std::int64_t at) {
    for (int i = 0; i < 3; ++i) {
      way[i] = 0.0;
      for (int j = 0; j < 3; ++j) {
        turn[3 * i + j] = 0.0;
        for (int k = 0; k < 3; ++k)
          turn[3 * i + j] += seen.rotation(k, i, first, at) * seen.rotation(k, j, second, at);
        way[i] += seen.rotation(j, i, first, at) * (seen.origin(j, second, at) - seen.origin(j, first, at));
      }
    }
  }
};

// How far the ball of one, whose centre is `way` from the box's, is outside the box.
inline double outside(const Cover& box, const double* way, double radius) {
  double square = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double along = box.axes[i] * way[0] + box.axes[3 + i] * way[1] + box.axes[6 + i] * way[2];
    const double far = std::max(std::abs(along) - box.half[i], 0.0);
    square += far * far;
  }
  // A ball whose centre is in the box may be deeper in it than its radius.
  return square > 0.0 ? std::sqrt(square) - radius : -std::numeric_limits<double>::infinity();
}

// A bound from below on the distance of two things, a better one where it is below `near`.
inline double bound(const Cover& one, const Cover& other, const Relative& seen, double near) {
  double way[3], back[3];
  for (int i = 0; i < 3; ++i)
    way[i] = seen.way[i] - one.centre[i] + seen.turn[3 * i] * other.centre[0] +
             seen.turn[3 * i + 1] * other.centre[1] + seen.turn[3 * i + 2] * other.centre[2];
  double least = std::sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]) - one.radius - other.radius;
  if (least < near) least = std::max(least, outside(one, way, other.radius));
  if (least < near) {
    for (int i = 0; i < 3; ++i)
      back[i] = seen.turn[i] * way[0] + seen.turn[3 + i] * way[1] + seen.turn[6 + i] * way[2];
    least = std::max(least, outside(other, back, one.radius));
  }
  return least;
}

// The corners of a convex part, in its body's axes, three numbers each.
struct Corners {
  const double* begin;
  std::int64_t count;

  // The corner that is the furthest along a direction, and how far that is.
  const double* furthest(const double* way, double& far) const {
    const double* best = begin;
    far = -std::numeric_limits<double>::infinity();
    for (const double* x = begin; x != begin + 3 * count; x += 3) {
      const double along = way[0] * x[0] + way[1] * x[1] + way[2] * x[2];
      if (along > far) {
        far = along;
        best = x;
      }
    }
    return best;
  }
};

// Looks for a direction along which two parts are at least `near` apart: that of the time before first, then
// towards the origin from what is found of the difference of the parts. Returns the gap, or less than `near`.
inline double gap(const Corners& one, const Corners& other, const Relative& seen, double near,
                  double* direction) {
  constexpr int kTries = 12;
  double v[3] = {}, way[3] = {direction[0], direction[1], direction[2]};
  double found = -std::numeric_limits<double>::infinity();
  for (int tried = 0; tried < kTries; ++tried) {
    double back[3], w[3], here, there;
    for (int i = 0; i < 3; ++i)
      back[i] = -(seen.turn[i] * way[0] + seen.turn[3 + i] * way[1] + seen.turn[6 + i] * way[2]);
    const double* a = one.furthest(way, here);
    const double* b = other.furthest(back, there);
    found = way[0] * seen.way[0] + way[1] * seen.way[1] + way[2] * seen.way[2] - there - here;
    if (found >= near) {
      std::copy(way, way + 3, direction);
      return found;
    }
    double vv = 0.0, vd = 0.0, dd = 0.0;
    for (int i = 0; i < 3; ++i) {
      w[i] = seen.way[i] + seen.turn[3 * i] * b[0] + seen.turn[3 * i + 1] * b[1] +
             seen.turn[3 * i + 2] * b[2] - a[i];
      if (tried == 0) v[i] = w[i];
      vd += v[i] * (v[i] - w[i]);
      dd += (v[i] - w[i]) * (v[i] - w[i]);
    }
    // The point of the way from v to w that is the nearest to the origin.
    const double share = dd > 0.0 ? std::min(std::max(vd / dd, 0.0), 1.0) : 0.0;
    for (int i = 0; i < 3; ++i) {
      v[i] += share * (w[i] - v[i]);
      vv += v[i] * v[i];
    }
    if (vv < near * near) break;  // the parts are nearer than that
    for (int i = 0; i < 3; ++i) way[i] = v[i] / std::sqrt(vv);
  }
  return found;
}

}  // namespace ffsms
