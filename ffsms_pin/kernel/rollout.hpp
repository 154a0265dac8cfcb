// The attitude of the base for a given joint motion: by time steps of order 4 on the rotation group, and by
// quadrature along splines.
//
// References: A. Iserles, H. Munthe-Kaas, S. Norsett, A. Zanna, "Lie-group methods", Acta Numerica 9 (2000);
// H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Applied Numerical Mathematics 29 (1999).
#pragma once

#include <algorithm>

#include "arm.hpp"

namespace ffsms {

// Returns the rotation matrix of a rotation vector [rad].
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

// The terms of the base's angular velocity at one instant, in base axes: the part due to the joint rates, and
// the inverse inertia, which gives the part due to the momentum.
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

// Returns du/dt for R(t) = R(0) exp(u) and the angular velocity omega in axes of R(t), by the series of the
// inverse derivative of the exponential. The first neglected term is of order 4 in u.
inline Vec3<double> rotation_vector_rate(const Vec3<double>& u, const Vec3<double>& omega) {
  const Vec3<double> bracket = cross(u, omega);
  return omega + 0.5 * bracket + (1.0 / 12.0) * cross(u, bracket);
}

// Returns du/dt as `rotation_vector_rate`, for the angular velocity that follows from `spin` and an angular
// momentum in axes of R(0).
inline Vec3<double> chart_rate(const Spin& spin, const Vec3<double>& u, const Vec3<double>& momentum) {
  return rotation_vector_rate(u, spin.reaction + spin.inverse * (transposed(exp3(u)) * momentum));
}

// Returns the attitude after one Runge-Kutta step of a system with an angular momentum in inertial axes.
inline Mat3<double> runge_kutta_step(const Mat3<double>& R, const Spin& start, const Spin& middle,
                                     const Spin& end, const Vec3<double>& momentum, double dt) {
  const Vec3<double> h = transposed(R) * momentum;
  const Vec3<double> k1 = chart_rate(start, Vec3<double>{}, h);
  const Vec3<double> k2 = chart_rate(middle, 0.5 * dt * k1, h);
  const Vec3<double> k3 = chart_rate(middle, 0.5 * dt * k2, h);
  const Vec3<double> k4 = chart_rate(end, dt * k3, h);
  return R * exp3((dt / 6.0) * (k1 + 2.0 * (k2 + k3) + k4));
}

// -- along a spline, by quadrature of the angular velocity

constexpr int kMostGauss = 8;

// The weights of the integrals from the start of each interval to its Gauss points, and over the interval.
// The instants of a motion are the Gauss points of all intervals, then the start of the interval `late`, then
// the end of the last interval.
struct Quadrature {
  int intervals, gauss, late;
  const double *to_points, *over;  // (intervals, gauss, gauss), (intervals, gauss)

  int points() const { return intervals * gauss; }
  int instants() const { return points() + 2; }
};

// The base at one instant, in base axes: its angular velocity due to the joint rates (reaction) and due to
// the momentum (own), the inverse of the system's inertia, and the attitude.
struct BaseRotation {
  Vec3<double> reaction, own;
  Mat3<double> inverse, attitude;
};

// Computes the attitudes at all instants for zero angular momentum, from the attitude at the start and the
// angular velocities at the Gauss points. Commutators of the angular velocities within an interval are
// neglected.
inline void attitudes_without_momentum(const Quadrature& rule, const Mat3<double>& start, BaseRotation* at) {
  const int g = rule.gauss;
  const auto put = [&](int k, const Mat3<double>& R) { at[k].attitude = R; };
  Mat3<double> R = start;
  for (int i = 0; i < rule.intervals; ++i) {
    if (i == rule.late) put(rule.points(), R);
    const auto rotated = [&](const double* weights) {
      Vec3<double> w = {};
      for (int e = 0; e < g; ++e) w += weights[e] * at[i * g + e].reaction;
      return R * exp3(w);
    };
    for (int b = 0; b < g; ++b) put(i * g + b, rotated(rule.to_points + (i * g + b) * g));
    R = rotated(rule.over + i * g);
  }
  put(rule.points() + 1, R);
}

// Computes the attitudes at all instants for an angular momentum in inertial axes. The part of the angular
// velocity due to the momentum depends on the attitude R exp(u), where R is the attitude at the start of an
// interval. The rotation vectors u at the Gauss points follow from collocation, by at most kIterations
// fixed-point iterations until u changes by less than kSettled. For a u longer than kLong the series in u
// would diverge, so the bounded integral of the angular velocity replaces u in the series.
inline void attitudes_with_momentum(const Quadrature& rule, const Mat3<double>& start,
                                    const Vec3<double>& momentum, BaseRotation* at) {
  constexpr int kIterations = 40;
  constexpr double kSettled = 1e-12, kLong = 1.5;  // [rad]
  const int g = rule.gauss;
  const auto put = [&](int k, const Mat3<double>& R) {
    at[k].attitude = R;
    at[k].own = at[k].inverse * (transposed(R) * momentum);
  };
  Vec3<double> spins[kMostGauss], turns[kMostGauss], rates[kMostGauss];
  Mat3<double> R = start;
  for (int i = 0; i < rule.intervals; ++i) {
    if (i == rule.late) put(rule.points(), R);
    const auto integral = [&](const double* weights, const Vec3<double>* values) {
      Vec3<double> w = {};
      for (int e = 0; e < g; ++e) w += weights[e] * values[e];
      return w;
    };
    const auto to_point = [&](int b) { return rule.to_points + (i * g + b) * g; };
    const Vec3<double> h = transposed(R) * momentum;
    std::fill_n(turns, g, Vec3<double>{});
    double change = 1.0;
    for (int n = 0; n < kIterations && change >= kSettled; ++n) {
      change = 0.0;
      for (int e = 0; e < g; ++e) {
        const BaseRotation& here = at[i * g + e];
        spins[e] = here.reaction + here.inverse * (transposed(exp3(turns[e])) * h);
      }
      for (int e = 0; e < g; ++e) {
        rates[e] = dot(turns[e], turns[e]) < kLong * kLong
                       ? rotation_vector_rate(turns[e], spins[e])
                       : spins[e] + 0.5 * cross(integral(to_point(e), spins), spins[e]);
      }
      for (int b = 0; b < g; ++b) {
        const Vec3<double> turn = integral(to_point(b), rates);
        for (int x = 0; x < 3; ++x) change = std::fmax(change, std::fabs(turn[x] - turns[b][x]));
        turns[b] = turn;
      }
    }
    for (int b = 0; b < g; ++b) put(i * g + b, R * exp3(turns[b]));
    R = R * exp3(integral(rule.over + i * g, rates));
  }
  put(rule.points() + 1, R);
}

// Computes the attitudes at all instants from the attitude at the start, for an angular momentum in inertial
// axes.
inline void base_attitudes(const Quadrature& rule, const Mat3<double>& start, const Vec3<double>& momentum,
                           BaseRotation* at) {
  if (dot(momentum, momentum) > 0.0) {
    attitudes_with_momentum(rule, start, momentum, at);
  } else {
    attitudes_without_momentum(rule, start, at);
  }
}

}  // namespace ffsms
