// One step of the paper's method: bounds on the joint rates, the wanted motion, the programme's matrices.
//
// All matrices are dense and lie row by row; n is the number of joints. Nothing is allocated here.
#pragma once

#include <algorithm>
#include <cmath>

#include "vec3.hpp"

namespace ffsms {

constexpr double kUnbounded = 1e20;  // stands for no bound in a programme, as `opt.UNBOUNDED`
constexpr double kFastest = 1e6;     // [rad/s^2] stands for no limit on an acceleration

// Greatest rate at the step's end from which a joint still stops before a limit that is `room` away.
inline double stoppable_rate(double room, double rate, double acceleration, double dt) {
  const double half = 0.5 * dt * acceleration;
  const double square = half * half + 2.0 * acceleration * (room - 0.5 * dt * rate);
  const double greatest = std::sqrt(std::max(square, 0.0)) - half;
  if (greatest >= 0.0) return greatest;
  const double turning = std::max(rate, 0.0);
  return std::min(rate - turning * turning * dt / (2.0 * std::max(room, 1e-300)), 0.0);
}

// The same within the limits of rate and acceleration; the latter comes last: it is never broken.
inline double greatest_rate(double room, double rate, double velocity, double acceleration, double dt) {
  const double limit = std::min(acceleration, kFastest), change = dt * limit;
  const double most = std::min(stoppable_rate(std::max(room, 0.0), rate, limit, dt), velocity);
  return std::max(std::min(most, rate + change), rate - change);
}

inline double dot(const double* a, const double* b, int n) {
  double sum = 0.0;
  for (int i = 0; i < n; ++i) sum += a[i] * b[i];
  return sum;
}

// The schedule of speeds: see opt/step/direction.py, whose constants these are.
struct Schedule {
  double power;           // what is left of the way shrinks as (time left)^power
  double after;           // steps after the deadline at which it ends
  double least_approach;  // below this cosine a path counts as if at it
  double nearing;         // share of the way that one step goes at most
  double time_left, dt;

  // Speed at the end of the next step that leads over the path that is left to the target at the deadline.
  double reference(double path_left, double speed) const {
    const double left_after = std::max(time_left - dt, 0.0) + after * dt;
    const double way = std::max(path_left - 0.5 * dt * speed, 0.0);
    return power * way / (left_after + 0.5 * dt * power);
  }

  // The same, as far as the joints can reach it in one step along a gradient (n,).
  double reached(double left, double speed, const double* gradient, const double* acceleration, int n) const {
    const double now = std::max(0.0, speed), wanted = reference(left, now);
    if (wanted <= now) return wanted;
    double gain = 0.0;
    for (int j = 0; j < n; ++j) gain += std::fabs(gradient[j]) * std::min(acceleration[j], kFastest);
    return std::min(wanted, now + dt * gain);
  }
};

// Unit vector across `towards`, as near to `hint` as possible; any, where that has no part across.
inline Vec3<double> lateral_direction(const Vec3<double>& towards, const Vec3<double>& hint) {
  Vec3<double> across = hint - dot(hint, towards) * towards;
  if (std::sqrt(dot(across, across)) < 1e-9) {  // the cross product with the axis that is furthest from it
    int k = 0;
    for (int i = 1; i < 3; ++i) {
      if (std::fabs(towards[i]) < std::fabs(towards[k])) k = i;
    }
    Vec3<double> axis = zero3<double>();
    axis[k] = 1.0;
    across = cross(towards, axis);
  }
  return across / std::sqrt(dot(across, across));
}

// A row (n,) times V (n, n).
inline void times_basis(const double* row, const double* V, int n, double* out) {
  std::fill_n(out, n, 0.0);
  for (int j = 0; j < n; ++j) {
    if (row[j] == 0.0) continue;
    for (int c = 0; c < n; ++c) out[c] += row[j] * V[j * n + c];
  }
}

// Solves equations (size, size + 1), the right sides last, where the solution then stands: by Gauss'
// elimination with row pivoting; false where they are singular.
inline bool solve(double* A, int size) {
  const int wide = size + 1;
  for (int k = 0; k < size; ++k) {
    int pivot = k;
    for (int i = k + 1; i < size; ++i) {
      if (std::fabs(A[i * wide + k]) > std::fabs(A[pivot * wide + k])) pivot = i;
    }
    if (!(std::fabs(A[pivot * wide + k]) > 0.0)) return false;
    if (pivot != k) std::swap_ranges(A + k * wide, A + (k + 1) * wide, A + pivot * wide);
    for (int i = k + 1; i < size; ++i) {
      const double factor = A[i * wide + k] / A[k * wide + k];
      if (factor == 0.0) continue;
      for (int j = k + 1; j < wide; ++j) A[i * wide + j] -= factor * A[k * wide + j];
    }
  }
  for (int k = size - 1; k >= 0; --k) {
    double& right = A[k * wide + size];
    for (int j = k + 1; j < size; ++j) right -= A[k * wide + j] * A[j * wide + size];
    right /= A[k * wide + k];
  }
  return true;
}

}  // namespace ffsms
