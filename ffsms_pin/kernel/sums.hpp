// Gauss-Newton sums of whole motions: from slopes of residuals by what moves to the gradient and the Hessian
// by the control points of the joints' spline.
//
// A base that floats follows the joints by the momentum equation. Its change under a change of the control
// points, as a rotation of everything about the centre of mass, is the integral of the change of its angular
// velocity: the same quadrature that gives the attitude gives its derivative, one interval after the other.
//
// This file knows no term and no limit: only what residuals may depend on. Control points are flattened with
// the joints last.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "own_slopes.hpp"
#include "rollout.hpp"

namespace ffsms {

// Maps from M control points of one joint to its rate, travel and acceleration at all instants, (K, M).
struct SplineMaps {
  int size;
  const double *rates, *travel, *accelerations;
};

// A number a joint at every instant, which depends on that joint alone.
struct JointResidual {
  std::ptrdiff_t count;
  const double* weight;
  Strided value, by_position, by_rate, by_acceleration;
};

class Sums {
 public:
  Sums(const Tree& tree, const ArmMotions& motions, const SplineMaps& spline, const Quadrature& quadrature)
      : own_(tree, motions, quadrature.instants()),
        spline_(spline),
        quadrature_(quadrature),
        n_(tree.n),
        size_(spline.size * tree.n),
        first_(static_cast<std::size_t>(quadrature.instants())),
        extent_(first_.size()),
        turned_(3 * first_.size() * static_cast<std::size_t>(size_)),
        change_(static_cast<std::size_t>(3 * quadrature.gauss * size_)),
        total_(static_cast<std::size_t>(3 * size_)),
        single_(static_cast<std::size_t>(spline.size)),
        rows_(static_cast<std::size_t>(kBatch * size_)) {
    find_extents();
  }

  // Sums of one motion, added to a gradient (M n,) and a Hessian (M n, M n) of zeros.
  void add(std::ptrdiff_t motion, const std::vector<Residual>& residuals,
           const std::vector<JointResidual>& of_joints, double* gradient, double* hessian) {
    gradient_ = gradient;
    hessian_ = hessian;
    own_.look_at_motion(motion);
    sweep();
    for (const Residual& residual : residuals) {
      for (std::ptrdiff_t i = 0; i < residual.count; ++i) {
        if (residual.motion == nullptr || residual.motion[i] == motion) add_value(residual, motion, i);
      }
    }
    flush();
    for (const JointResidual& residual : of_joints) add_joints(residual, motion);
    for (int a = 0; a < size_; ++a) {
      for (int b = a + 1; b < size_; ++b) hessian_[a * size_ + b] = hessian_[b * size_ + a];
    }
  }

 private:
  static constexpr int kBatch = 4;  // rows that one pass over the Hessian adds

  // Early instants depend on the first control points alone, rates and accelerations on a few.
  void find_extents() {
    const int M = spline_.size, Q = quadrature_.points();
    for (int k = 0; k < Q + 2; ++k) {
      int first = M, end = 0;
      for (int m = 0; m < M; ++m) {
        const int at = k * M + m;
        const bool now = spline_.rates[at] != 0.0 || spline_.accelerations[at] != 0.0;
        if (now) first = std::min(first, m);
        if (now || spline_.travel[at] != 0.0) end = m + 1;
      }
      first_[k] = first;
      extent_[k] = end;
    }
    // The base's turn within an interval follows from all points of it, and from those before.
    int widest = 0;
    for (int i = 0; i < quadrature_.intervals; ++i) {
      int* own = &extent_[i * quadrature_.gauss];
      widest = std::max(widest, *std::max_element(own, own + quadrature_.gauss));
      std::fill(own, own + quadrature_.gauss, widest);
      if (i == quadrature_.late - 1) extent_[Q] = std::max(extent_[Q], widest);
    }
    extent_[Q + 1] = std::max(extent_[Q + 1], widest);
  }

  // How everything turns about the centre of mass, inertial axes: (3, M n) at each instant.
  double* turned(std::ptrdiff_t k) { return &turned_[3 * size_ * k]; }

  void sweep() {
    const int g = quadrature_.gauss;
    std::fill(total_.begin(), total_.end(), 0.0);
    for (int i = 0; i < quadrature_.intervals; ++i) {
      if (i == quadrature_.late) std::copy(total_.begin(), total_.end(), turned(quadrature_.points()));
      const int wide = extent_[i * g] * n_;
      for (int b = 0; b < g; ++b) spin_changes(i * g + b, &change_[3 * size_ * b], wide);
      for (int b = 0; b < g; ++b) {
        double* here = turned(i * g + b);
        std::copy(total_.begin(), total_.end(), here);
        integrate(quadrature_.to_points + (i * g + b) * g, wide, here);
      }
      integrate(quadrature_.over + i * g, wide, total_.data());
    }
    std::copy(total_.begin(), total_.end(), turned(quadrature_.points() + 1));
  }

  void integrate(const double* weights, int wide, double* out) {
    for (int e = 0; e < quadrature_.gauss; ++e) {
      for (int x = 0; x < 3; ++x) {
        const double* change = &change_[(3 * e + x) * size_];
        double* sum = out + x * size_;
        for (int c = 0; c < wide; ++c) sum[c] += weights[e] * change[c];
      }
    }
  }

  // How the base's angular velocity changes, inertial axes: (3, M n).
  void spin_changes(int k, double* out, int wide) {
    const double *travel = spline_.travel + k * spline_.size, *rates = spline_.rates + k * spline_.size;
    for (int j = 0; j < n_; ++j) {
      const Vec3<double> by_travel = own_.instant(k).attitude * own_.columns(k)[j].spin_slope;
      const Vec3<double> by_rate = own_.instant(k).attitude * own_.columns(k)[j].spin;
      for (int x = 0; x < 3; ++x) {
        double* row = out + x * size_;
        for (int m = 0, c = j; c < wide; ++m, c += n_)
          row[c] = by_travel[x] * travel[m] + by_rate[x] * rates[m];
      }
    }
  }

  // The row of one value by the control points, kept until there are enough for a pass.
  void add_value(const Residual& r, std::ptrdiff_t motion, std::ptrdiff_t i) {
    if (r.weight[i] == 0.0) return;
    const Own& own = own_.slopes(r, i);
    if (own.none(n_)) return;
    const std::ptrdiff_t k = r.instants[i];
    const double *travel = spline_.travel + k * spline_.size, *rates = spline_.rates + k * spline_.size;
    const double* accelerations = spline_.accelerations + k * spline_.size;
    const int end = extent_[k], wide = end * n_;
    double* row = &rows_[waiting_ * size_];
    const double* T = turned(k);
    for (int c = 0; c < wide; ++c) {
      row[c] = own.turn[0] * T[c] + own.turn[1] * T[size_ + c] + own.turn[2] * T[2 * size_ + c];
    }
    for (int m = 0, c = 0; m < end; ++m) {
      for (int j = 0; j < n_; ++j, ++c) row[c] += own.travel[j] * travel[m];
    }
    for (int m = first_[k], c = m * n_; m < end; ++m) {
      for (int j = 0; j < n_; ++j, ++c)
        row[c] += own.rates[j] * rates[m] + own.accelerations[j] * accelerations[m];
    }
    weights_[waiting_] = r.weight[i];
    values_[waiting_] = r.value.at(r.motion == nullptr ? motion : 0, i)(0);
    wide_[waiting_] = wide;
    if (++waiting_ == kBatch) flush();
  }

  // Rows to the gradient and to the lower triangle of the Hessian.
  void flush() {
    if (waiting_ == 0) return;
    const int wide = *std::max_element(wide_, wide_ + waiting_);
    for (int i = 0; i < kBatch; ++i) {
      if (i >= waiting_) weights_[i] = values_[i] = 0.0, wide_[i] = 0;
      std::fill(&rows_[i * size_] + wide_[i], &rows_[i * size_] + wide, 0.0);
    }
    const double *r0 = rows_.data(), *r1 = r0 + size_, *r2 = r1 + size_, *r3 = r2 + size_;
    for (int a = 0; a < wide; ++a) {
      const double w0 = weights_[0] * r0[a], w1 = weights_[1] * r1[a];
      const double w2 = weights_[2] * r2[a], w3 = weights_[3] * r3[a];
      gradient_[a] += w0 * values_[0] + w1 * values_[1] + w2 * values_[2] + w3 * values_[3];
      double* out = hessian_ + a * size_;
      for (int b = 0; b <= a; ++b) out[b] += w0 * r0[b] + w1 * r1[b] + w2 * r2[b] + w3 * r3[b];
    }
    waiting_ = 0;
  }

  // What depends on one joint alone: that joint's entries of the lower triangle.
  void add_joints(const JointResidual& r, std::ptrdiff_t motion) {
    for (std::ptrdiff_t k = 0; k < r.count; ++k) {
      if (r.weight[k] == 0.0) continue;
      const double *travel = spline_.travel + k * spline_.size, *rates = spline_.rates + k * spline_.size;
      const double* accelerations = spline_.accelerations + k * spline_.size;
      const int first = r.by_position ? 0 : first_[k], end = extent_[k];
      for (int j = 0; j < n_; ++j) {
        const auto slope = [&](const Strided& of) { return of ? of.at(motion, k)(0, j) : 0.0; };
        const double by_position = slope(r.by_position), by_rate = slope(r.by_rate);
        const double by_acceleration = slope(r.by_acceleration), value = r.value.at(motion, k)(0, j);
        for (int m = first; m < end; ++m) {
          single_[m] = by_position * travel[m] + by_rate * rates[m] + by_acceleration * accelerations[m];
        }
        for (int a = first; a < end; ++a) {
          const double weighted = r.weight[k] * single_[a];
          gradient_[a * n_ + j] += weighted * value;
          double* out = hessian_ + (a * n_ + j) * size_ + j;
          for (int b = first; b <= a; ++b) out[b * n_] += weighted * single_[b];
        }
      }
    }
  }

  OwnSlopes own_;
  const SplineMaps& spline_;
  const Quadrature& quadrature_;
  const int n_, size_;
  std::vector<int> first_, extent_;  // of the control points that matter at an instant
  std::vector<double> turned_, change_, total_, single_, rows_;
  double weights_[kBatch], values_[kBatch];
  int wide_[kBatch], waiting_ = 0;
  double *gradient_ = nullptr, *hessian_ = nullptr;
};

}  // namespace ffsms
