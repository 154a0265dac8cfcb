// The attitude of a base along a motion, by quadrature of its angular velocity.
#pragma once

#include <cmath>

#include "strided.hpp"

namespace ffsms {

// Integrals from the start of each interval to its points, and over it. The instants of a motion are all
// points of all intervals, then the start of the interval `late`, then the end of the last one.
struct Quadrature {
  int intervals, gauss, late;
  const double *to_points, *over;  // (intervals, gauss, gauss), (intervals, gauss)

  int points() const { return intervals * gauss; }
  int instants() const { return points() + 2; }
};

constexpr double kTiny = 1e-150;  // added to angles: sin(x) / x is then one at zero

// The rotation of a rotation vector [rad].
inline Mat3<double> exp3(const Vec3<double>& w) {
  const double square = dot(w, w), angle = std::sqrt(square) + kTiny;
  const double half = std::sin(0.5 * angle) / angle, first = std::sin(angle) / angle,
               second = 2.0 * half * half;
  Mat3<double> out = outer(w, second * w);
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    out[i][i] += 1.0 - second * square;
    out[k][j] += first * w[i];
    out[j][k] -= first * w[i];
  }
  return out;
}

// The rotation vector [rad] of a rotation, by its quaternion: sound up to half a turn. The largest column of
// 4 q q^T, so that nothing is lost there (I. Y. Bar-Itzhack, 2000).
inline Vec3<double> log3(const Mat3<double>& R) {
  double K[4][4];
  const double trace = R[0][0] + R[1][1] + R[2][2];
  K[3][3] = 1.0 + trace;
  for (int i = 0; i < 3; ++i) {
    const int a = (i + 1) % 3, b = (i + 2) % 3;
    K[i][i] = 1.0 + 2.0 * R[i][i] - trace;
    K[i][a] = K[a][i] = R[i][a] + R[a][i];
    K[i][3] = K[3][i] = R[b][a] - R[a][b];
  }
  int most = 0;
  for (int i = 1; i < 4; ++i) {
    if (K[i][i] > K[most][most]) most = i;
  }
  const double* q = K[most];
  const double sign = q[3] < 0.0 ? -1.0 : 1.0;
  const Vec3<double> v = {{sign * q[0], sign * q[1], sign * q[2]}};
  const double size = std::sqrt(dot(v, v));
  const double factor =
      size < 1e-9 * std::fabs(q[3]) ? 2.0 / std::fabs(q[3]) : 2.0 * std::atan2(size, sign * q[3]) / size;
  return factor * v;
}

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
