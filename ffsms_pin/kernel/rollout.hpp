// How the base turns under given joint motion: steps of order 4 on the rotations, and quadrature along
// splines.
//
// References: A. Iserles, H. Munthe-Kaas, S. Norsett, A. Zanna, "Lie-group methods", Acta Numerica 9 (2000);
// H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Applied Numerical Mathematics 29 (1999).
#pragma once

#include "arm.hpp"

namespace ffsms {

// The rotation of a rotation vector [rad].
template <class T>
Mat3<T> exp3(const Vec3<T>& w) {
  const T square = dot(w, w), angle = root(square) + 1e-150;  // sin(x) / x is then one at zero
  T sine, cosine, half, unused;
  sine_cosine(angle, sine, cosine);
  sine_cosine(0.5 * angle, half, unused);
  half = half / angle;
  const T twice = 2.0 * half * half;
  Mat3<T> out = outer(w, twice * w);
  const T diagonal = 1.0 - twice * square;
  out[0][0] += diagonal;
  out[1][1] += diagonal;
  out[2][2] += diagonal;
  out += skew((sine / angle) * w);
  return out;
}

// What decides the angular velocity at one instant, in base axes: that of the joint rates, and what the
// momentum adds.
struct Spin {
  Vec3<double> reaction;
  Mat3<double> inverse;
};

inline Spin spin_at(const Tree& tree, const double* positions, const double* rates, Arm<double>& arm) {
  pose(tree, positions, arm);
  carry(tree, arm);
  Vec3<double> linear = Vec3<double>{}, angular = Vec3<double>{}, spin, root;
  for (int j = 0; j < tree.n; ++j) {
    momentum(tree, j, arm);
    linear += rates[j] * arm.linear[j];
    angular += rates[j] * arm.angular[j];
  }
  react(tree, arm, linear, angular, spin, root);
  return {spin, arm.inverse};
}

// With R(t) = R(0) exp(u), and the angular momentum in axes of R(0): the rate of u, which is the inverse of
// the exponential's derivative, to order 4.
inline Vec3<double> chart_rate(const Spin& spin, const Vec3<double>& u, const Vec3<double>& momentum) {
  const Vec3<double> omega = spin.reaction + spin.inverse * (transposed(exp3(u)) * momentum);
  const Vec3<double> bracket = cross(u, omega);
  return omega + 0.5 * bracket + (1.0 / 12.0) * cross(u, bracket);
}

// The attitude a step later, of a system with angular momentum in inertial axes: one step of Runge and Kutta.
inline Mat3<double> tumbled(const Mat3<double>& R, const Spin& start, const Spin& middle, const Spin& end,
                            const Vec3<double>& momentum, double dt) {
  const Vec3<double> h = transposed(R) * momentum;
  const Vec3<double> k1 = chart_rate(start, Vec3<double>{}, h);
  const Vec3<double> k2 = chart_rate(middle, 0.5 * dt * k1, h);
  const Vec3<double> k3 = chart_rate(middle, 0.5 * dt * k2, h);
  const Vec3<double> k4 = chart_rate(end, dt * k3, h);
  return R * exp3((dt / 6.0) * (k1 + 2.0 * (k2 + k3) + k4));
}

// -- along a spline, by quadrature of its angular velocity

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
      Vec3<double> w = Vec3<double>{};
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
