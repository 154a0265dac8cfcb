// Gauss-Newton sums of whole motions: from slopes of residuals by what moves to the gradient and the Hessian
// by the control points of the joints' spline.
//
// A base that floats follows the joints by the momentum equation. Its change under a change of the control
// points, as a rotation of everything about the centre of mass, is the integral of the change of its angular
// velocity: the same quadrature that gives the attitude gives its derivative, one interval after the other.
//
// This file knows no term and no limit: only what residuals may depend on. Arrays are those of Python, with
// any strides; control points are flattened with the joints last.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace ffsms {

// An array (component, joint, motion, instant); along an axis that it does not have the stride is zero.
struct Strided {
  const double* data = nullptr;
  std::ptrdiff_t component = 0, joint = 0, motion = 0, instant = 0;

  explicit operator bool() const { return data != nullptr; }

  // Of one motion at one instant.
  Strided at(std::ptrdiff_t s, std::ptrdiff_t k) const {
    return {data + s * motion + k * instant, component, joint, 0, 0};
  }

  double operator()(int c, int j = 0) const { return data[c * component + j * joint]; }
};

// Maps from M control points of one joint to its rate, travel and acceleration at Q + 2 instants, and the
// quadrature: integrals from the start of each interval to its points, and over it.
struct SplineMaps {
  int size, intervals, gauss, late;
  const double *rates, *travel, *accelerations;  // (Q + 2, M)
  const double *to_points, *over;                // (intervals, gauss, gauss), (intervals, gauss)

  int points() const { return intervals * gauss; }
  int instants() const { return points() + 2; }
};

// Motions of the arm, base axes but for the attitude; slopes *_q are those by the joint positions.
struct ArmMotions {
  int joints;
  double mass;                          // that a force on the base moves; may be infinite
  const double *base_com, *moves_tip;   // (3,), (n,)
  Strided rates, own_spin, attitude;    // (n, ..), (3, ..), (3, 3, ..)
  Strided spin, jstar, axes, linear;    // (3, n, ..)
  Strided com, tip;                     // (3, ..)
  Strided spin_q, jstar_q, tip_spin_q;  // (3, n, ..)
  Strided entropy_q;                    // (n, ..)
};

// Numbers at instants of motions: all of `count` instants of each motion, or `count` entries, each of one
// motion. Slopes are by what their names say, in inertial axes; what is absent does not matter.
struct Residual {
  std::ptrdiff_t count;
  const std::int64_t* instants;
  const std::int64_t* motion;  // null where dense
  const double* weight;
  Strided value, by_joints, by_rates, by_accelerations;
  Strided by_tip, by_turn, by_velocity, by_spin, by_base, by_base_turn, by_base_spin, by_entropy;
};

// A number a joint at every instant, which depends on that joint alone.
struct JointResidual {
  std::ptrdiff_t count;
  const double* weight;
  Strided value, by_position, by_rate, by_acceleration;
};

class Sums {
 public:
  Sums(const SplineMaps& spline, const ArmMotions& arm)
      : spline_(spline),
        arm_(arm),
        n_(arm.joints),
        size_(spline.size * arm.joints),
        first_(spline.instants()),
        extent_(spline.instants()),
        turned_(3 * size_ * spline.instants()),
        change_(3 * size_ * spline.gauss),
        total_(3 * size_),
        own_(3 * n_),
        single_(spline.size),
        rows_(kBatch * size_) {
    find_extents();
  }

  // Sums of one motion, added to a gradient (M n,) and a Hessian (M n, M n) of zeros.
  void add(std::ptrdiff_t motion, const std::vector<Residual>& residuals,
           const std::vector<JointResidual>& of_joints, double* gradient, double* hessian) {
    gradient_ = gradient, hessian_ = hessian;
    sweep(motion);
    for (const Residual& residual : residuals) {
      for (std::ptrdiff_t i = 0; i < residual.count; i++) {
        if (residual.motion == nullptr || residual.motion[i] == motion) add_value(residual, motion, i);
      }
    }
    flush();
    for (const JointResidual& residual : of_joints) add_joints(residual, motion);
    for (int a = 0; a < size_; a++)
      for (int b = a + 1; b < size_; b++) hessian_[a * size_ + b] = hessian_[b * size_ + a];
  }

 private:
  static constexpr int kBatch = 4;  // rows that one pass over the Hessian adds

  using Vector = double[3];

  static void cross(const Vector a, const Vector b, Vector out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
  }

  // Early instants depend on the first control points alone, rates and accelerations on a few.
  void find_extents() {
    const int M = spline_.size, Q = spline_.points();
    for (int k = 0; k < Q + 2; k++) {
      int first = M, end = 0;
      for (int m = 0; m < M; m++) {
        const int at = k * M + m;
        const bool now = spline_.rates[at] != 0.0 || spline_.accelerations[at] != 0.0;
        if (now) first = std::min(first, m);
        if (now || spline_.travel[at] != 0.0) end = m + 1;
      }
      first_[k] = first, extent_[k] = end;
    }
    // The base's turn within an interval follows from all points of it, and from those before.
    int widest = 0;
    for (int i = 0; i < spline_.intervals; i++) {
      int* own = &extent_[i * spline_.gauss];
      widest = std::max(widest, *std::max_element(own, own + spline_.gauss));
      std::fill(own, own + spline_.gauss, widest);
      if (i == spline_.late - 1) extent_[Q] = std::max(extent_[Q], widest);
    }
    extent_[Q + 1] = std::max(extent_[Q + 1], widest);
  }

  double* turned(std::ptrdiff_t k) { return &turned_[3 * size_ * k]; }

  // How everything turns about the centre of mass, inertial axes: (3, M n) at each instant.
  void sweep(std::ptrdiff_t motion) {
    const int g = spline_.gauss;
    std::fill(total_.begin(), total_.end(), 0.0);
    for (int i = 0; i < spline_.intervals; i++) {
      const int wide = extent_[i * g] * n_;
      for (int b = 0; b < g; b++) base_spin(motion, i * g + b, &change_[3 * size_ * b], wide);
      for (int b = 0; b < g; b++) {
        double* here = turned(i * g + b);
        std::copy(total_.begin(), total_.end(), here);
        integrate(&spline_.to_points[(i * g + b) * g], wide, here);
      }
      integrate(&spline_.over[i * g], wide, total_.data());
      if (i == spline_.late - 1) std::copy(total_.begin(), total_.end(), turned(spline_.points()));
    }
    std::copy(total_.begin(), total_.end(), turned(spline_.points() + 1));
  }

  void integrate(const double* weights, int wide, double* out) {
    for (int e = 0; e < spline_.gauss; e++) {
      for (int x = 0; x < 3; x++) {
        const double* change = &change_[(3 * e + x) * size_];
        double* sum = out + x * size_;
        for (int c = 0; c < wide; c++) sum[c] += weights[e] * change[c];
      }
    }
  }

  // How the base's angular velocity changes, inertial axes: (3, M n).
  void base_spin(std::ptrdiff_t motion, int k, double* out, int wide) {
    const Strided R = arm_.attitude.at(motion, k);
    const Strided by_rate = arm_.spin.at(motion, k), by_travel = arm_.spin_q.at(motion, k);
    const double *travel = &spline_.travel[k * spline_.size], *rates = &spline_.rates[k * spline_.size];
    for (int x = 0; x < 3; x++) {
      double* row = out + x * size_;
      for (int j = 0; j < n_; j++) {
        double along_rate = 0.0, along_travel = 0.0;
        for (int y = 0; y < 3; y++) {
          along_rate += R(x, y) * by_rate(y, j);
          along_travel += R(x, y) * by_travel(y, j);
        }
        for (int m = 0, c = j; c < wide; m++, c += n_)
          row[c] = along_travel * travel[m] + along_rate * rates[m];
      }
    }
  }

  // Slopes of one value by the joint's positions and rates where the base stays, and by a turn of all.
  bool own_slopes(const Residual& r, std::ptrdiff_t s, std::ptrdiff_t i, std::ptrdiff_t motion,
                  std::ptrdiff_t k, Vector turn) {
    double *travel = own_.data(), *rates = travel + n_, *accelerations = rates + n_;
    std::fill(own_.begin(), own_.end(), 0.0);
    const Strided R = arm_.attitude.at(motion, k);
    Vector moment = {0.0, 0.0, 0.0};  // base axes
    const auto inward = [&](const Strided& slope, Vector g) {
      const Strided by = slope.at(s, i);
      for (int x = 0; x < 3; x++) g[x] = R(0, x) * by(0) + R(1, x) * by(1) + R(2, x) * by(2);
    };
    const auto joints = [&](const Strided& slope, double* out) {
      if (!slope) return;
      const Strided by = slope.at(s, i);
      for (int j = 0; j < n_; j++) out[j] += by(0, j);
    };
    const auto along = [&](const Strided& columns, const Vector g, double factor, double* out) {
      const Strided of = columns.at(motion, k);
      for (int j = 0; j < n_; j++) out[j] += factor * (of(0, j) * g[0] + of(1, j) * g[1] + of(2, j) * g[2]);
    };
    const auto carried = [&](const Vector g, double* out) {
      const Strided of = arm_.axes.at(motion, k);
      for (int j = 0; j < n_; j++)
        out[j] += arm_.moves_tip[j] * (of(0, j) * g[0] + of(1, j) * g[1] + of(2, j) * g[2]);
    };
    const auto turned = [&](const Vector lever, const Vector g) {
      Vector add;
      cross(lever, g, add);
      for (int x = 0; x < 3; x++) moment[x] += add[x];
    };
    const auto speed = [&](const Strided& columns, Vector out) {
      const Strided of = columns.at(motion, k), u = arm_.rates.at(motion, k);
      for (int j = 0; j < n_; j++)
        for (int x = 0; x < 3; x++) out[x] += of(x, j) * u(0, j);
    };
    const Strided own = arm_.own_spin.at(motion, k);
    const Strided com = arm_.com.at(motion, k), tip = arm_.tip.at(motion, k);
    const Vector rho = {tip(0) - com(0), tip(1) - com(1), tip(2) - com(2)};
    Vector g, velocity;
    joints(r.by_joints, travel);
    joints(r.by_rates, rates);
    joints(r.by_accelerations, accelerations);
    if (r.by_tip) {
      inward(r.by_tip, g);
      Vector lever;
      cross(rho, g, lever);
      along(arm_.jstar, g, 1.0, travel);
      along(arm_.spin, lever, -1.0, travel);
      turned(rho, g);
    }
    if (r.by_velocity) {
      inward(r.by_velocity, g);
      along(arm_.jstar, g, 1.0, rates);
      along(arm_.jstar_q, g, 1.0, travel);
      const Vector given = {own(0), own(1), own(2)};
      cross(given, rho, velocity);
      speed(arm_.jstar, velocity);
      turned(velocity, g);
    }
    if (r.by_turn) {
      inward(r.by_turn, g);
      carried(g, travel);
      for (int x = 0; x < 3; x++) moment[x] += g[x];
    }
    if (r.by_spin) {
      inward(r.by_spin, g);
      along(arm_.spin, g, 1.0, rates);
      carried(g, rates);
      along(arm_.tip_spin_q, g, 1.0, travel);
      for (int x = 0; x < 3; x++) velocity[x] = own(x);
      speed(arm_.spin, velocity);
      const Strided axes = arm_.axes.at(motion, k), u = arm_.rates.at(motion, k);
      for (int j = 0; j < n_; j++)
        for (int x = 0; x < 3; x++) velocity[x] += arm_.moves_tip[j] * axes(x, j) * u(0, j);
      turned(velocity, g);
    }
    if (r.by_base) {
      inward(r.by_base, g);
      along(arm_.linear, g, -1.0 / arm_.mass, travel);
      const double* base = arm_.base_com;
      const Vector lever = {base[0] - com(0), base[1] - com(1), base[2] - com(2)};
      turned(lever, g);
    }
    if (r.by_base_turn) {
      inward(r.by_base_turn, g);
      for (int x = 0; x < 3; x++) moment[x] += g[x];
    }
    if (r.by_base_spin) {
      inward(r.by_base_spin, g);
      along(arm_.spin, g, 1.0, rates);
      along(arm_.spin_q, g, 1.0, travel);
      for (int x = 0; x < 3; x++) velocity[x] = own(x);
      speed(arm_.spin, velocity);
      turned(velocity, g);
    }
    if (r.by_entropy) {
      const double slope = r.by_entropy.at(s, i)(0);
      const Strided by = arm_.entropy_q.at(motion, k);
      for (int j = 0; j < n_; j++) travel[j] += slope * by(0, j);
    }
    for (int x = 0; x < 3; x++) turn[x] = R(x, 0) * moment[0] + R(x, 1) * moment[1] + R(x, 2) * moment[2];
    const auto zero = [](double x) { return x == 0.0; };
    return !(std::all_of(own_.begin(), own_.end(), zero) && std::all_of(turn, turn + 3, zero));
  }

  // The row of one value by the control points, kept until there are enough for a pass.
  void add_value(const Residual& r, std::ptrdiff_t motion, std::ptrdiff_t i) {
    const std::ptrdiff_t k = r.instants[i], s = r.motion == nullptr ? motion : 0;
    Vector turn;
    if (r.weight[i] == 0.0 || !own_slopes(r, s, i, motion, k, turn)) return;
    const double *by_travel = own_.data(), *by_rates = by_travel + n_, *by_acceleration = by_rates + n_;
    const double *travel = &spline_.travel[k * spline_.size], *rates = &spline_.rates[k * spline_.size];
    const double* accelerations = &spline_.accelerations[k * spline_.size];
    const int end = extent_[k], wide = end * n_;
    double* row = &rows_[waiting_ * size_];
    const double* T = turned(k);
    for (int c = 0; c < wide; c++)
      row[c] = turn[0] * T[c] + turn[1] * T[size_ + c] + turn[2] * T[2 * size_ + c];
    for (int m = 0, c = 0; m < end; m++)
      for (int j = 0; j < n_; j++, c++) row[c] += by_travel[j] * travel[m];
    for (int m = first_[k], c = m * n_; m < end; m++)
      for (int j = 0; j < n_; j++, c++)
        row[c] += by_rates[j] * rates[m] + by_acceleration[j] * accelerations[m];
    weights_[waiting_] = r.weight[i], values_[waiting_] = r.value.at(s, i)(0), wide_[waiting_] = wide;
    if (++waiting_ == kBatch) flush();
  }

  // Rows to the gradient and to the lower triangle of the Hessian.
  void flush() {
    if (waiting_ == 0) return;
    const int wide = *std::max_element(wide_, wide_ + waiting_);
    for (int i = 0; i < kBatch; i++) {
      if (i >= waiting_) weights_[i] = values_[i] = 0.0, wide_[i] = 0;
      std::fill(&rows_[i * size_] + wide_[i], &rows_[i * size_] + wide, 0.0);
    }
    const double *r0 = rows_.data(), *r1 = r0 + size_, *r2 = r1 + size_, *r3 = r2 + size_;
    for (int a = 0; a < wide; a++) {
      const double w0 = weights_[0] * r0[a], w1 = weights_[1] * r1[a];
      const double w2 = weights_[2] * r2[a], w3 = weights_[3] * r3[a];
      gradient_[a] += w0 * values_[0] + w1 * values_[1] + w2 * values_[2] + w3 * values_[3];
      double* out = hessian_ + static_cast<std::ptrdiff_t>(a) * size_;
      for (int b = 0; b <= a; b++) out[b] += w0 * r0[b] + w1 * r1[b] + w2 * r2[b] + w3 * r3[b];
    }
    waiting_ = 0;
  }

  // What depends on one joint alone: that joint's entries of the lower triangle.
  void add_joints(const JointResidual& r, std::ptrdiff_t motion) {
    for (std::ptrdiff_t k = 0; k < r.count; k++) {
      if (r.weight[k] == 0.0) continue;
      const double* travel = &spline_.travel[k * spline_.size];
      const double* rates = &spline_.rates[k * spline_.size];
      const double* accelerations = &spline_.accelerations[k * spline_.size];
      const int first = r.by_position ? 0 : first_[k], end = extent_[k];
      for (int j = 0; j < n_; j++) {
        const auto slope = [&](const Strided& of) { return of ? of.at(motion, k)(0, j) : 0.0; };
        const double by_position = slope(r.by_position), by_rate = slope(r.by_rate);
        const double by_acceleration = slope(r.by_acceleration);
        if (by_position == 0.0 && by_rate == 0.0 && by_acceleration == 0.0) continue;
        for (int m = first; m < end; m++)
          single_[m] = by_position * travel[m] + by_rate * rates[m] + by_acceleration * accelerations[m];
        const double value = r.value.at(motion, k)(0, j);
        for (int a = first; a < end; a++) {
          const double weighted = r.weight[k] * single_[a];
          gradient_[a * n_ + j] += weighted * value;
          double* out = hessian_ + static_cast<std::ptrdiff_t>(a * n_ + j) * size_ + j;
          for (int b = first; b <= a; b++) out[b * n_] += weighted * single_[b];
        }
      }
    }
  }

  const SplineMaps& spline_;
  const ArmMotions& arm_;
  const int n_, size_;
  std::vector<int> first_, extent_;  // of the control points that matter at an instant
  std::vector<double> turned_, change_, total_, own_, single_, rows_;
  double weights_[kBatch], values_[kBatch];
  int wide_[kBatch], waiting_ = 0;
  double *gradient_ = nullptr, *hessian_ = nullptr;
};

}  // namespace ffsms
