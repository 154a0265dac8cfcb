// The attitude of a base along the motion of a spline, by quadrature of its angular velocity.
#pragma once

#include "rollout.hpp"

namespace ffsms {

// Integrals from the start of each interval to its points, and over it. The instants of a motion are all
// points of all intervals, then the start of the interval `late`, then the end of the last one.
struct Quadrature {
  int intervals, gauss, late;
  const double *to_points, *over;  // (intervals, gauss, gauss), (intervals, gauss)

  int points() const { return intervals * gauss; }
  int instants() const { return points() + 2; }
};

// Attitudes at all instants from that at the start and angular velocities at the points, in base axes.
inline void base_attitudes(const Quadrature& by, const Mat3<double>& start, const Vec3<double>* omega,
                           Mat3<double>* attitude) {
  const int g = by.gauss;
  Mat3<double> at = start;
  for (int i = 0; i < by.intervals; ++i) {
    if (i == by.late) attitude[by.points()] = at;
    const auto turn = [&](const double* weights) {
      Vec3<double> w = zero3<double>();
      for (int e = 0; e < g; ++e) w += weights[e] * omega[i * g + e];
      return at * exp3(w);
    };
    for (int b = 0; b < g; ++b) attitude[i * g + b] = turn(by.to_points + (i * g + b) * g);
    at = turn(by.over + i * g);
  }
  attitude[by.points() + 1] = at;
}

// Picard's iteration for the attitude of a tumbling base: at most so many times, until it changes by less.
constexpr int kPicard = 20;
constexpr double kSettled = 1e-10;

// The same where angular momentum adds to the spin what the attitude makes of it. At all instants, base axes:
// `inverse` of the inertia, `reaction` the spin without momentum, `own` what it adds; `spin` and `before` are
// room to work in.
inline void drifting_attitudes(const Quadrature& by, const Mat3<double>& start, const Vec3<double>* reaction,
                               const Mat3<double>* inverse, const Vec3<double>& momentum,
                               Mat3<double>* attitude, Vec3<double>* own, Vec3<double>* spin,
                               Mat3<double>* before) {
  const int count = by.instants();
  base_attitudes(by, start, reaction, attitude);
  for (int n = 0; n < kPicard; ++n) {
    for (int k = 0; k < count; ++k) {
      before[k] = attitude[k];
      own[k] = inverse[k] * (transposed(attitude[k]) * momentum);
      spin[k] = reaction[k] + own[k];
    }
    base_attitudes(by, start, spin, attitude);
    double change = 0.0;
    for (int k = 0; k < count; ++k) {
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j)
          change = std::fmax(change, std::fabs(attitude[k][i][j] - before[k][i][j]));
      }
    }
    if (change < kSettled) break;
  }
}

}  // namespace ffsms
