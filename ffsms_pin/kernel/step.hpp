// One step of the paper's method: bounds on the joint rates, the desired motion, and the matrices of the QP.
//
// All matrices are dense and stored by rows; n is the number of joints.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>

#include "arm.hpp"

namespace ffsms {

constexpr double kUnbounded = 1e20;  // means no bound in a QP, as `opt.UNBOUNDED`
constexpr double kFastest = 1e6;     // [rad/s^2] replaces larger acceleration limits

// Returns the largest rate at the step's end from which a joint can stop before a limit at `distance`; see
// `rate_bounds` in opt/step/state.py.
inline double stoppable_rate(double distance, double rate, double acceleration, double dt) {
  const double half = 0.5 * dt * acceleration;
  const double square = half * half + 2.0 * acceleration * (distance - 0.5 * dt * rate);
  const double greatest = std::sqrt(std::max(square, 0.0)) - half;
  if (greatest >= 0.0) return greatest;
  const double towards = std::max(rate, 0.0);
  return std::min(rate - towards * towards * dt / (2.0 * std::max(distance, 1e-300)), 0.0);
}

// Returns the largest rate at the step's end from which a joint can stop before a limit at `distance`, within
// the limits of rate and acceleration. The acceleration limit has priority over the other limits.
inline double greatest_rate(double distance, double rate, double velocity, double acceleration, double dt) {
  const double limit = std::min(acceleration, kFastest), change = dt * limit;
  const double most = std::min(stoppable_rate(std::max(distance, 0.0), rate, limit, dt), velocity);
  return std::max(std::min(most, rate + change), rate - change);
}

inline double dot(const double* a, const double* b, int n) {
  double sum = 0.0;
  for (int i = 0; i < n; ++i) sum += a[i] * b[i];
  return sum;
}

// The remaining distance decreases as (remaining time)^p. With p = 2.5 speed and deceleration end at zero,
// the speed at the start is 2.5 times the mean, and 0.3 % of the distance remains at 0.9 T, the start of the
// paper's const8.
constexpr double kArrivalPower = 2.5;
// The least cosine for the length of a path. With a smaller cosine the path would be a spiral of many turns.
constexpr double kLeastApproach = 0.2;

// Returns the scheduled speed at the end of the next step. The schedule ends two steps after the deadline,
// because an end effector at rest has no direction, which the paper's cost would penalise at the last step.
inline double reference_speed(double path_left, double speed, double time_left, double dt) {
  const double left_after = std::max(time_left - dt, 0.0) + 2.0 * dt;
  const double left = std::max(path_left - 0.5 * dt * speed, 0.0);
  return kArrivalPower * left / (left_after + 0.5 * dt * kArrivalPower);
}

// Returns the cosine at which the cost of a step with this H_norm is zero,
// log(exp(kappa (1 - H_norm)) - 1) / kappa, clipped to [-1, 1]; see `ideal_cosine` in opt/costs.py.
inline double ideal_cosine(double entropy, double kappa) {
  const double x = kappa * (1.0 - entropy);
  if (!(x > 0.0)) return -1.0;
  // log(exp(x) - 1) = x + log(1 - exp(-x)), without overflow.
  return std::min(1.0, std::max(-1.0, (x + std::log(-std::expm1(-x))) / kappa));
}

// Returns the unit vector orthogonal to `towards` that is nearest to `hint`. If `hint` is zero or parallel to
// `towards`, any orthogonal unit vector is returned.
inline Vec3<double> lateral_direction(const Vec3<double>& towards, const Vec3<double>& hint) {
  Vec3<double> across = hint - dot(hint, towards) * towards;
  if (std::sqrt(dot(across, across)) < 1e-9) {  // the cross product with the axis furthest from `towards`
    int k = 0;
    for (int i = 1; i < 3; ++i) {
      if (std::fabs(towards[i]) < std::fabs(towards[k])) k = i;
    }
    Vec3<double> axis = Vec3<double>{};
    axis[k] = 1.0;
    across = cross(towards, axis);
  }
  return across / std::sqrt(dot(across, across));
}

// Returns the rotation vector [rad] of a rotation, by its quaternion q. The largest column of 4 q q^T is
// used, so that no accuracy is lost near half a turn (S. W. Shepperd, "Quaternion from rotation matrix",
// 1978).
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

// Returns the paper's H_norm of singular values (n), with 0 log 0 = 0; 0 if all values are zero, or if n = 1.
inline double normalised_entropy(const double* sigma, int n) {
  double total = 0.0, sum = 0.0;
  for (int i = 0; i < n; ++i) total += sigma[i];
  for (int i = 0; i < n && n > 1; ++i) {
    const double share = total > 0.0 ? sigma[i] / total : 0.0;
    if (share > 0.0) sum -= share * std::log(share);
  }
  return n > 1 ? std::min(1.0, std::max(0.0, sum / std::log(static_cast<double>(n)))) : 0.0;
}

// Solves linear equations (size, size + 1) by Gaussian elimination with partial pivoting. The last column is
// the right side, which is replaced by the solution. Returns false if the matrix is singular.
inline bool solve(double* A, int size) {
  const int width = size + 1;
  for (int k = 0; k < size; ++k) {
    int pivot = k;
    for (int i = k + 1; i < size; ++i) {
      if (std::fabs(A[i * width + k]) > std::fabs(A[pivot * width + k])) pivot = i;
    }
    if (!(std::fabs(A[pivot * width + k]) > 0.0)) return false;
    if (pivot != k) std::swap_ranges(A + k * width, A + (k + 1) * width, A + pivot * width);
    for (int i = k + 1; i < size; ++i) {
      const double factor = A[i * width + k] / A[k * width + k];
      if (factor == 0.0) continue;
      for (int j = k + 1; j < width; ++j) A[i * width + j] -= factor * A[k * width + j];
    }
  }
  for (int k = size - 1; k >= 0; --k) {
    double& right = A[k * width + size];
    for (int j = k + 1; j < size; ++j) right -= A[k * width + j] * A[j * width + size];
    right /= A[k * width + k];
  }
  return true;
}

// The arguments of one step of n joints.
struct StepArguments {
  int n;
  const double *J, *V;                   // J* (6, n), and the basis of the joint rates (n, n)
  const double *rates, *drift;           // joint rates (n), and the end effector's twist (6) at zero rates
  const double* acceleration;            // acceleration limits (n)
  Vec3<double> to_target, side;          // vector to the target [m]; lateral direction, or zero for none
  Mat3<double> attitude;                 // attitude of the end effector
  std::optional<Mat3<double>> rotation;  // desired attitude
  double cosine, time_left, dt;          // cosine of the angle between motion and `to_target`; times [s]
};

// The desired motion of the end effector: unit vectors to the target (`towards`), along the velocity
// (`direction`), and orthogonal to `towards` (`side`); the angular velocity; the speed.
struct DesiredMotion {
  Vec3<double> towards, direction, side, spin;
  double speed;
};

// The weights of a step's objective; see `opt.StepWeights`.
struct StepWeights {
  double direction, speed, orientation, effort, change, clearance;
};

// Returns the scheduled speed along a direction, at most the speed that the joints can reach in one step,
// because a larger speed would change the direction. `row` is the first of the three rows of J of the speed.
inline double reachable_speed(const StepArguments& step, int row, double path_left,
                              const Vec3<double>& direction) {
  const double* J = step.J + row * step.n;
  double speed = dot(direction, of_numbers<Vec3<double>>(step.drift + row)), gain = 0.0;
  for (int j = 0; j < step.n; ++j) {
    const double along = dot(direction, Vec3<double>{{J[j], J[step.n + j], J[2 * step.n + j]}});
    speed += along * step.rates[j];
    gain += std::fabs(along) * std::min(step.acceleration[j], kFastest);
  }
  const double now = std::max(0.0, speed);
  return std::min(reference_speed(path_left, now, step.time_left, step.dt), now + step.dt * gain);
}

inline DesiredMotion desired_motion(const StepArguments& step) {
  constexpr double kArrived = 1e-12;  // [m, rad] smaller distances are rounding errors
  DesiredMotion out = {{}, {}, step.side, {}, 0.0};
  const double distance = std::sqrt(dot(step.to_target, step.to_target));
  if (!(distance < kArrived)) {
    out.towards = step.to_target / distance;
    if (dot(step.side, step.side) == 0.0) {  // the end effector's velocity replaces the lateral direction
      for (int i = 0; i < 3; ++i) out.side[i] = dot(step.J + i * step.n, step.rates, step.n) + step.drift[i];
    }
    out.side = lateral_direction(out.towards, out.side);
    const double sine = std::sqrt(std::max(0.0, 1.0 - step.cosine * step.cosine));
    out.direction = step.cosine * out.towards + sine * out.side;
    // A path at a constant angle to the direction of the target is 1 / cos times as long as the distance. A
    // step is at most half as long as the straight step to the point nearest to the target, because a longer
    // step at an angle to the target would not approach it.
    const double along = std::max(step.cosine, kLeastApproach);
    out.speed =
        std::min(reachable_speed(step, 0, distance / along, out.direction), 0.5 * distance * along / step.dt);
  }
  if (step.rotation) {
    const Vec3<double> turn = log3(*step.rotation * transposed(step.attitude));
    const double angle = std::sqrt(dot(turn, turn));
    if (angle >= kArrived) out.spin = reachable_speed(step, 3, angle, turn / angle) * (turn / angle);
  }
  return out;
}

// Adds the objective 1/2 x^T H x + g^T x to H (n + 2, n + 2) and g; x is [rates in the basis V; s; slack].
inline void add_objective(const StepArguments& step, const DesiredMotion& desired, const StepWeights& weights,
                          double* H, double* g) {
  const int n = step.n, size = n + 2;
  double row[kMostJoints + 1];
  // J V alpha + drift should equal s times the direction, and the desired angular velocity.
  for (int r = 0; r < (step.rotation ? 6 : 3); ++r) {
    const double weight = r < 3 ? weights.direction : weights.orientation;
    const double offset = r < 3 ? step.drift[r] : step.drift[r] - desired.spin[r - 3];
    for (int c = 0; c < n; ++c) {
      row[c] = 0.0;
      for (int j = 0; j < n; ++j) row[c] += step.J[r * n + j] * step.V[j * n + c];
    }
    row[n] = r < 3 ? -desired.direction[r] : 0.0;
    for (int i = 0; i <= n; ++i) {
      const double weighted = weight * row[i];
      g[i] += weighted * offset;
      for (int j = 0; j <= n; ++j) H[i * size + j] += weighted * row[j];
    }
  }
  // V is orthogonal, so |u| = |alpha|, and effort and change are diagonal in alpha, too.
  for (int i = 0; i < n; ++i) {
    H[i * size + i] += weights.change + weights.effort;
    for (int j = 0; j < n; ++j) g[i] -= weights.change * step.rates[j] * step.V[j * n + i];
  }
  H[n * size + n] += weights.speed;
  g[n] -= weights.speed * desired.speed;
  H[(n + 1) * size + n + 1] += weights.clearance;
  g[n + 1] += weights.clearance;
}

}  // namespace ffsms
