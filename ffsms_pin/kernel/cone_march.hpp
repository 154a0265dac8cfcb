// Coarse marches to a target at the angle to its direction that costs nothing, or straight: a damped
// least-squares solution a step.
#pragma once

#include <algorithm>

#include "entropy.hpp"
#include "rollout.hpp"
#include "step.hpp"

namespace ffsms {

// What all marches from one start share.
struct ConeMarch {
  double duration;                  // [s]
  double kappa;                     // of the paper's cost
  double mean_speed;                // of a straight way to the target [m/s]
  double damping;                   // of the least squares [m]
  Vec3<double> target, com, drift;  // of the centre of mass
  Mat3<double> attitude;            // of the base at the start
};

// Least rates (n) with J u near to what is wanted (m), for J (m, n). Damping must not slow what can be done:
// one step of refinement takes most of it back.
inline void least_rates(int m, int n, const double* J, const double* wanted, double damping, double* u) {
  const int wide = m + 1;
  double left[6], equations[6 * 7];
  std::copy(wanted, wanted + m, left);
  std::fill(u, u + n, 0.0);
  for (int pass = 0; pass < 2; ++pass) {
    for (int i = 0; i < m; ++i) {
      for (int j = 0; j < m; ++j) equations[i * wide + j] = dot(J + i * n, J + j * n, n);
      equations[i * wide + i] += damping * damping;
      equations[i * wide + m] = left[i];
    }
    solve(equations, m);
    for (int i = 0; i < m; ++i) {
      for (int k = 0; k < n; ++k) u[k] += J[i * n + k] * equations[i * wide + m];
    }
    for (int i = 0; i < m; ++i) {
      left[i] = wanted[i];
      for (int k = 0; k < n; ++k) left[i] -= J[i * n + k] * u[k];
    }
  }
}

// Joint rates (steps, n) of a march to that side of the target's direction; straight where it is zero. Leads
// to an attitude, where one is wanted, from the joints' positions, limits and greatest rates (4, n).
inline void cone_march(const Tree& tree, int steps, const ConeMarch& by,
                       const std::optional<Mat3<double>>& rotation, const double* joints, Vec3<double> side,
                       double* out) {
  const int n = tree.n;
  const double *low = joints + n, *high = low + n, *most = high + n;
  const double dt = by.duration / steps;
  const bool straight = dot(side, side) == 0.0;
  double q[kMostJoints] = {}, J[6 * kMostJoints], wanted[6], unused[6 * kMostJoints], speed = 0.0;
  std::copy(joints, low, q);
  Mat3<double> R = by.attitude;
  Arm<double> arm;
  for (int k = 0; k < steps; ++k, out += n) {
    evaluate(tree, q, arm);
    const Vec3<double> com = by.com + (k * dt) * by.drift;
    const Vec3<double> way = by.target - com - R * (arm.tip - arm.com);
    const double distance = std::sqrt(dot(way, way)) + 1e-12;
    const Vec3<double> d = (1.0 / distance) * way;
    const double cosine = straight ? 1.0 : ideal_cosine(entropy(6, n, arm.coupling, unused), by.kappa);
    side = side - dot(side, d) * d;
    side = (1.0 / (std::sqrt(dot(side, side)) + 1e-12)) * side;
    const Vec3<double> e = cosine * d + std::sqrt(std::fmax(1.0 - cosine * cosine, 0.0)) * side;
    const double left = by.duration - k * dt;
    const double share = kArrivalPower / (left + 0.5 * kArrivalPower * dt);
    // The speed rises over a tenth of the time to its mean.
    const double mean = std::fmax(by.mean_speed, distance / by.duration);
    speed = std::fmin(share * distance / std::fmax(cosine, kLeastApproach),
                      speed + 10.0 / steps * mean * kArrivalPower);
    const Vec3<double> velocity = speed * e - by.drift;
    Vec3<double> turn = {}, spin = {}, moved[kMostJoints], turned[kMostJoints];
    if (rotation) turn = share * log3(*rotation * transposed(R * arm.tip_rotation));
    for (int j = 0; j < n; ++j) {
      moved[j] = R * arm.jstar[j];
      turned[j] = R * arm.jstar_spin[j];
    }
    Writer<double> rows = {J, 1}, asked = {wanted, 1};
    for (const auto* columns : {moved, turned}) rows.put(columns, n);
    asked.put(&velocity);
    asked.put(&turn);
    least_rates(rotation ? 6 : 3, n, J, wanted, by.damping, out);
    double used = 1.0;  // of the greatest rates, the largest share
    for (int j = 0; j < n; ++j) used = std::fmax(used, std::fabs(out[j]) / std::fmax(most[j], 1e-12));
    for (int j = 0; j < n; ++j) {
      const double rate = most[j] > 0.0 ? out[j] / used : 0.0;
      out[j] = std::fmin(std::fmax(rate, (low[j] - q[j]) / dt), (high[j] - q[j]) / dt);
      q[j] += dt * out[j];
      spin += out[j] * arm.spin[j];
    }
    R = R * exp3(dt * spin);
  }
}

}  // namespace ffsms
