// One step of the paper's method: bounds on the joint rates, the wanted motion, the programme's matrices.
//
// All matrices are dense and lie row by row; n is the number of joints. Nothing is allocated here.
#pragma once

#include <algorithm>
#include <cmath>

namespace ffsms::step {

constexpr double unbounded = 1e20;  // stands for no bound in a programme, as `opt.UNBOUNDED`
constexpr double fastest = 1e6;     // [rad/s^2] stands for no limit on an acceleration

// -- bounds on the joint rates ----------------------------------------------------------------------------

// Greatest rate at the step's end from which a joint still stops before a limit that is `room` away.
inline double stoppable_rate(double room, double rate, double acceleration, double dt) {
  const double half = 0.5 * dt * acceleration;
  const double square = half * half + 2.0 * acceleration * (room - 0.5 * dt * rate);
  const double greatest = std::sqrt(std::max(square, 0.0)) - half;
  if (greatest >= 0.0) return greatest;
  const double turning = std::max(rate, 0.0);
  return std::min(rate - turning * turning * dt / (2.0 * std::max(room, 1e-300)), 0.0);
}

struct JointLimit {
  double lower, upper, velocity, acceleration;
};

// Least and greatest rate at the step's end; the acceleration limit comes last: it is never broken.
inline void rate_bounds(const JointLimit& limit, double position, double rate, double dt, double& least,
                        double& greatest) {
  const double acceleration = std::min(limit.acceleration, fastest), change = dt * acceleration;
  const double velocity = std::min(limit.velocity, unbounded);
  const auto towards = [&](double wall, double sense) {
    const double room = std::max(wall - sense * position, 0.0), moving = sense * rate;
    const double most = std::min(stoppable_rate(room, moving, acceleration, dt), velocity);
    return std::max(std::min(most, moving + change), moving - change);
  };
  greatest = towards(limit.upper, 1.0);
  least = -towards(-limit.lower, -1.0);
  greatest = std::max(greatest, least);  // where there is no room to brake, the lower one is both
}

// -- where the end effector should go ---------------------------------------------------------------------

inline double dot(const double* a, const double* b, int n = 3) {
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
};

// Speed at the end of the next step that leads over the path that is left to the target at the deadline.
inline double reference_speed(const Schedule& schedule, double path_left, double speed, double time_left,
                              double dt) {
  const double left_after = std::max(time_left - dt, 0.0) + schedule.after * dt;
  const double way = std::max(path_left - 0.5 * dt * speed, 0.0);
  return schedule.power * way / (left_after + 0.5 * dt * schedule.power);
}

// The schedule's speed, as far as the joints can reach it in one step along a gradient (n,).
inline double scheduled(const Schedule& schedule, double left, double speed, const double* gradient,
                        const double* acceleration, int n, double time_left, double dt) {
  const double now = std::max(0.0, speed);
  const double wanted = reference_speed(schedule, left, now, time_left, dt);
  if (wanted <= now) return wanted;
  double gain = 0.0;
  for (int j = 0; j < n; ++j) gain += std::fabs(gradient[j]) * std::min(acceleration[j], fastest);
  return std::min(wanted, now + dt * gain);
}

// Unit vector across `towards`, as near to `hint` as possible; any, where that has no part across.
inline void lateral_direction(const double* towards, const double* hint, double* lateral) {
  const double along = dot(hint, towards);
  for (int i = 0; i < 3; ++i) lateral[i] = hint[i] - along * towards[i];
  double size = std::sqrt(dot(lateral, lateral));
  if (size < 1e-9) {  // the cross product with the axis that is furthest from it
    int k = 0;
    for (int i = 1; i < 3; ++i)
      if (std::fabs(towards[i]) < std::fabs(towards[k])) k = i;
    lateral[k] = 0.0;
    lateral[(k + 1) % 3] = towards[(k + 2) % 3];
    lateral[(k + 2) % 3] = -towards[(k + 1) % 3];
    size = std::sqrt(dot(lateral, lateral));
  }
  for (int i = 0; i < 3; ++i) lateral[i] /= size;
}

// Unit vector at the angle acos(cosine) to `towards`, on the side `lateral`.
inline void cone_direction(const double* towards, const double* lateral, double cosine, double* direction) {
  const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
  for (int i = 0; i < 3; ++i) direction[i] = cosine * towards[i] + sine * lateral[i];
}

// -- the programme ----------------------------------------------------------------------------------------

// A (rows, n) times V (n, n), written with a row length of `stride`.
inline void times_basis(const double* A, const double* V, int rows, int n, double* out, int stride) {
  for (int r = 0; r < rows; ++r) {
    double* row = out + r * stride;
    for (int c = 0; c < n; ++c) row[c] = 0.0;
    for (int j = 0; j < n; ++j) {
      const double a = A[r * n + j];
      if (a == 0.0) continue;
      for (int c = 0; c < n; ++c) row[c] += a * V[j * n + c];
    }
  }
}

// Adds weight |S x - wanted|^2 / 2 of S (rows, size) to 1/2 x^T H x + g^T x, up to a constant.
inline void add_square(const double* S, const double* wanted, int rows, int size, double weight, double* H,
                       double* g) {
  for (int r = 0; r < rows; ++r) {
    const double* s = S + r * size;
    for (int i = 0; i < size; ++i) {
      const double c = weight * s[i];
      if (c == 0.0) continue;
      g[i] -= c * wanted[r];
      for (int j = 0; j < size; ++j) H[i * size + j] += c * s[j];
    }
  }
}

// Solves A x = b by Gauss' elimination with row pivoting, in place; false where A is singular.
inline bool solve(double* A, double* b, int size) {
  for (int k = 0; k < size; ++k) {
    int pivot = k;
    for (int i = k + 1; i < size; ++i)
      if (std::fabs(A[i * size + k]) > std::fabs(A[pivot * size + k])) pivot = i;
    if (!(std::fabs(A[pivot * size + k]) > 0.0)) return false;
    if (pivot != k) {
      std::swap_ranges(A + k * size, A + (k + 1) * size, A + pivot * size);
      std::swap(b[k], b[pivot]);
    }
    for (int i = k + 1; i < size; ++i) {
      const double factor = A[i * size + k] / A[k * size + k];
      if (factor == 0.0) continue;
      for (int j = k + 1; j < size; ++j) A[i * size + j] -= factor * A[k * size + j];
      b[i] -= factor * b[k];
    }
  }
  for (int k = size - 1; k >= 0; --k) {
    for (int j = k + 1; j < size; ++j) b[k] -= A[k * size + j] * b[j];
    b[k] /= A[k * size + k];
  }
  return true;
}

}  // namespace ffsms::step
