// Gauss-Newton sums of whole motions: the gradient and the Hessian by the control points of the joints'
// spline (flattened, the joints last) from derivatives of residuals by the motion of end effector, base and
// arm.
//
// The base reacts to the joints: it rotates, and translates relative to the centre of mass. A residual
// therefore depends on the joint positions, rates and accelerations at its instant, and on a rotation of the
// whole system about the centre of mass. This rotation is the integral of the change of the base's angular
// velocity. The quadrature of the attitude also gives the derivatives of the rotation by the control points,
// one interval after the other.
//
// With an angular momentum h, the angular velocity also changes with the inertia and with the rotation
// itself. The small rotation theta of the whole system, inertial axes, has the time derivative c + A theta
// with A theta = R J (h x R^T theta). R is the attitude, J and h are the inverse inertia and the angular
// momentum in base axes, and c depends on the joints alone.
#pragma once

#include <algorithm>

#include "rollout.hpp"
#include "slopes.hpp"

namespace ffsms {

// An array with the axes (row, component, joint, motion, instant); the step along a missing axis is zero.
struct Strided {
  const double* data;
  Index step[5];

  explicit operator bool() const { return data != nullptr; }
};

// The names of the derivatives of residuals. The first seven are derivatives by vectors in inertial axes:
// three vectors that also depend on the joint rates (kRated), two more vectors that a rotation of the whole
// system rotates (kLevered), and two rotations. If a residual has one row per joint, its "own" derivatives
// are the derivatives of row j by joint j.
constexpr const char* kNames[] = {"by_velocity",      "by_spin",          "by_base_spin", "by_tip",
                                  "by_base",          "by_turn",          "by_base_turn", "by_joints",
                                  "by_rates",         "by_accelerations", "own_joint",    "own_rate",
                                  "own_acceleration", "by_entropy",       "by_coupling"};
constexpr int kBaseSpin = 2, kRated = 3, kTip = 3, kLevered = 5, kVectors = 7;
constexpr int kJoints = 7, kOwnJoint = 10, kEntropy = 13, kCoupling = 14, kSlopes = 15;

// A residual (rows) at `count` instants of each motion (dense), or at `count` entries (motion, instant).
// Missing derivatives are zero.
struct Residual {
  Index rows, count;
  const Index *instants, *motion;  // `motion` is null if dense
  const double* weight;
  Strided value, by[kSlopes];

  // Returns true if row j depends on joint j alone.
  bool alone() const {
    const auto there = [](const Strided& slope) { return static_cast<bool>(slope); };
    return std::none_of(by, by + kOwnJoint, there) && std::none_of(by + kEntropy, by + kSlopes, there);
  }
};

// One row of a residual at one instant of one motion.
struct Value {
  const Residual& residual;
  Index row, motion, i;

  double operator()(const Strided& x, int component = 0, int joint = 0) const {
    return x.data[row * x.step[0] + component * x.step[1] + joint * x.step[2] + motion * x.step[3] +
                  i * x.step[4]];
  }
  double by(int slope) const { return residual.by[slope] ? (*this)(residual.by[slope]) : 0.0; }
  Index instant() const { return residual.instants[i]; }
};

// The rows of all motions, `stack` doubles each: joint positions and rates (n each), the base's attitude (9),
// the base's angular velocity due to the momentum (3), and if `entropy` is true the derivative of H_norm by
// C_bm (6 n). The angular momentum is in inertial axes.
struct MotionRows {
  const double* first;
  std::size_t stack;
  bool entropy;
  Vec3<double> momentum;
};

// The matrices (3, K, M) that map M control points of a joint to its position, rate and acceleration at K
// instants.
struct SplineMaps {
  int size;
  const double* maps;
};

// The robot at one instant, in base axes.
template <class T>
struct Instant {
  Vec3<T> lever[kLevered];    // the vectors that a rotation of the whole system rotates
  Mat3<T> attitude, inverse;  // of the base; of the system's inertia
  Vec3<T> momentum;           // angular momentum

  // Returns the derivative of a function by a rotation of the whole system. The function has the derivative g
  // by the angular velocity, and the rotation changes the angular velocity due to the momentum.
  Vec3<T> own_moment(const Vec3<T>& g) const { return cross(inverse * g, momentum); }
};
// The derivatives of the vectors by a joint's position (travel) and rate at a constant base attitude, and of
// H_norm by the joint's position.
template <class T>
struct Column {
  Vec3<T> travel[kVectors], rate[kRated];
  T entropy;
};

// Returns one lane of a struct that consists of packs.
template <template <class> class Of, class T>
Of<double> lane(const Of<T>& packs, int i) {
  Of<double> out;
  Reader<double>{reinterpret_cast<const double*>(&packs) + i, sizeof(T) / sizeof(double)}.next(&out);
  return out;
}

class Sums {
 public:
  // `memory` is working memory for `needed` numbers.
  Sums(const Tree& tree, const MotionRows& motions, const SplineMaps& spline, const Quadrature& rule,
       double* memory)
      : tree_(tree), motions_(motions), spline_(spline), quadrature_(rule), memory_(memory) {
    std::fill_n(rows_, kBatch * size_, 0.0);
    compute_extents();
  }

  static std::size_t needed(const Tree& tree, const SplineMaps& spline, const Quadrature& quadrature) {
    const int size = spline.size * tree.n, own = sizeof(Instant<double>) / sizeof(double) + 1;
    const int columns = tree.n * static_cast<int>(sizeof(Column<double>) / sizeof(double));
    return static_cast<std::size_t>(quadrature.instants() * (own + columns + 3 * size) +
                                    (3 * quadrature.gauss + 3 + kBatch) * size);
  }

  // Adds the sums of one motion to a gradient (M n,) and to a symmetric Hessian (M n, M n).
  template <class Residuals>
  void add(Index motion, const Residuals& residuals, double* gradient, double* hessian) {
    gradient_ = gradient;
    hessian_ = hessian;
    motion_ = motion;
    int k = 0;
    for (; k + kLanes <= K_; k += kLanes) evaluate_instants(k, packs_);
    for (; k < K_; ++k) evaluate_instants(k, arm_);
    integrate_rotations();
    for (const Residual& residual : residuals) {
      const bool alone = residual.alone();
      for (Index row = 0; row < residual.rows; ++row) {
        for (Index i = 0; i < residual.count; ++i) {
          if (residual.weight[i] == 0.0 || (residual.motion && residual.motion[i] != motion)) continue;
          const Value value = {residual, row, residual.motion ? 0 : motion, i};
          alone ? add_alone(value) : add_row(value);
        }
      }
    }
    flush();
    for (int a = 0; a < size_; ++a) {
      for (int b = a + 1; b < size_; ++b) hessian_[a * size_ + b] = hessian_[b * size_ + a];
    }
  }

 private:
  static constexpr int kBatch = 4;  // number of rows that one pass over the Hessian adds

  const double* map(int which, Index k) const { return spline_.maps + (which * K_ + k) * spline_.size; }

  // Computes for each instant the number of first control points on which it depends. The base's rotation in
  // an interval depends on all control points of this interval and of the intervals before it.
  void compute_extents() {
    const int g = quadrature_.gauss, Q = quadrature_.points();
    Index widest = 0;
    const auto reached = [&](int k) {
      Index end = widest;
      for (int m = 0; m < spline_.size; ++m) {
        if (map(0, k)[m] != 0.0 || map(1, k)[m] != 0.0 || map(2, k)[m] != 0.0)
          end = std::max<Index>(end, m + 1);
      }
      return end;
    };
    for (int i = 0; i < quadrature_.intervals; ++i) {
      if (i == quadrature_.late) extent_[Q] = reached(Q);
      for (int b = 0; b < g; ++b) widest = reached(i * g + b);
      std::fill_n(extent_ + i * g, g, widest);
    }
    extent_[Q + 1] = reached(Q + 1);
  }

  // Computes the arm, the levers and the columns at an instant, or at the instants of a pack.
  template <class T>
  void evaluate_instants(int begin, Arm<T>& arm) {
    T joints[kMostJoints], rates[kMostJoints], by_coupling[6 * kMostJoints], by_entropy[kMostJoints] = {};
    Vec3<T> spin_slope[kMostJoints], tip_slope[kMostJoints], turning_slope[kMostJoints], base_spin;
    Instant<T> at;
    Reader<T> read = {motions_.first + motion_ * K_ + begin, motions_.stack};
    for (T* row : {joints, rates}) read.next(row, n_);
    read.next(&at.attitude);
    read.next(&base_spin);
    evaluate(tree_, joints, arm);
    velocity_slopes(tree_, arm, rates, base_spin, spin_slope, tip_slope);
    turning_slopes(tree_, arm, rates, turning_slope);
    if (motions_.entropy) {
      read.next(by_coupling, 6 * n_);
      coupling_slopes(tree_, arm, by_coupling, by_entropy);
    }
    const int lanes = sizeof(T) / sizeof(double);
    const Vec3<T> rho = arm.tip - arm.com;
    Vec3<T> velocity = cross(base_spin, rho), turning = {};
    for (int j = 0; j < n_; ++j) {
      const Vec3<T>& spin = arm.spin[j];
      const Column<T> column = {{tip_slope[j],
                                 spin_slope[j] + turning_slope[j],
                                 spin_slope[j],
                                 arm.jstar[j] - cross(spin, rho),
                                 -tree_.inverse_mass * arm.linear[j],
                                 arm.tip_spin[j],
                                 {}},
                                {arm.jstar[j], arm.jstar_spin[j], spin},
                                by_entropy[j]};
      for (int i = 0; i < lanes; ++i) columns_[(begin + i) * n_ + j] = lane(column, i);
      base_spin += rates[j] * spin;
      velocity += rates[j] * arm.jstar[j];
      turning += rates[j] * arm.tip_spin[j];
    }
    const Vec3<T> levers[] = {velocity, base_spin + turning, base_spin, rho,
                              Vec3<T>(tree_.base_com) - arm.com};
    std::copy_n(levers, kLevered, at.lever);
    at.inverse = arm.inverse;
    at.momentum = transposed(at.attitude) * Vec3<T>(motions_.momentum);
    for (int i = 0; i < lanes; ++i) instants_[begin + i] = lane(at, i);
  }

  // The derivative (3, M n) of the whole system's rotation at instant k by the control points, inertial axes.
  double* rotation_slopes(Index k) { return rotation_slopes_ + 3 * size_ * k; }

  void integrate_rotations() {
    const int g = quadrature_.gauss;
    std::fill_n(total_, 3 * size_, 0.0);
    for (int i = 0; i < quadrature_.intervals; ++i) {
      if (i == quadrature_.late) std::copy_n(total_, 3 * size_, rotation_slopes(quadrature_.points()));
      const Index width = extent_[i * g] * n_;
      for (int b = 0; b < g; ++b) spin_changes(i * g + b, change_ + 3 * size_ * b, width);
      for (int b = 0; b < g; ++b) {
        std::copy_n(total_, 3 * size_, rotation_slopes(i * g + b));
        integrate(quadrature_.to_points + (i * g + b) * g, width, rotation_slopes(i * g + b));
      }
      if (tumbles_) tumble(i, width);
      integrate(quadrature_.over + i * g, width, total_);
    }
    std::copy_n(total_, 3 * size_, rotation_slopes(quadrature_.points() + 1));
  }

  // Replaces the rotations theta_0 + a c at the points of an interval, which were computed without A, by the
  // solution theta of (1 - a A) theta = theta_0 + a c with the quadrature weights a (gauss, gauss).
  // Elimination without pivoting suffices, because the matrix is near the identity.
  void tumble(int interval, Index width) {
    const int g = quadrature_.gauss, first = interval * g, rows = 3 * g;
    double A[9 * kMostGauss], M[9 * kMostGauss * kMostGauss];
    for (int e = 0; e < g; ++e) {
      const Instant<double>& at = instants_[first + e];
      const Mat3<double> own = at.attitude * at.inverse * skew(at.momentum) * transposed(at.attitude);
      std::copy_n(&own[0][0], 9, A + 9 * e);
    }
    for (int r = 0; r < rows; ++r) {
      const double* weights = quadrature_.to_points + (first + r / 3) * g;
      for (int c = 0; c < rows; ++c)
        M[r * rows + c] = (r == c ? 1.0 : 0.0) - weights[c / 3] * A[9 * (c / 3) + 3 * (r % 3) + c % 3];
    }
    double* theta = rotation_slopes(first);  // the rows of the points of an interval are contiguous
    const auto subtract = [&](int row, int other, double factor) {
      double* out = theta + row * size_;
      const double* of = theta + other * size_;
      for (Index c = 0; c < width; ++c) out[c] -= factor * of[c];
    };
    for (int k = 0; k < rows; ++k) {
      for (int r = k + 1; r < rows; ++r) {
        const double factor = M[r * rows + k] / M[k * rows + k];
        for (int c = k; c < rows; ++c) M[r * rows + c] -= factor * M[k * rows + c];
        subtract(r, k, factor);
      }
    }
    for (int k = rows; k-- > 0;) {
      for (int c = k + 1; c < rows; ++c) subtract(k, c, M[k * rows + c]);
      for (Index c = 0; c < width; ++c) theta[k * size_ + c] /= M[k * rows + k];
    }
    for (int r = 0; r < rows; ++r) {
      const double *row = A + 3 * r, *turn = theta + 3 * (r / 3) * size_;
      double* change = change_ + r * size_;
      for (Index c = 0; c < width; ++c)
        change[c] += row[0] * turn[c] + row[1] * turn[size_ + c] + row[2] * turn[2 * size_ + c];
    }
  }

  void integrate(const double* weights, Index width, double* out) {
    for (int e = 0; e < quadrature_.gauss; ++e) {
      for (int x = 0; x < 3; ++x) {
        const double* change = change_ + (3 * e + x) * size_;
        double* sum = out + x * size_;
        for (Index c = 0; c < width; ++c) sum[c] += weights[e] * change[c];
      }
    }
  }

  // Computes the derivative (3, M n) of the base's angular velocity by the control points, inertial axes.
  void spin_changes(int k, double* out, Index width) {
    const double *travel = map(0, k), *rates = map(1, k);
    for (int j = 0; j < n_; ++j) {
      const Column<double>& column = columns_[k * n_ + j];
      const Vec3<double> by_travel = instants_[k].attitude * column.travel[kBaseSpin];
      const Vec3<double> by_rate = instants_[k].attitude * column.rate[kBaseSpin];
      for (int x = 0; x < 3; ++x) {
        double* row = out + x * size_;
        for (Index m = 0, c = j; c < width; ++m, c += n_)
          row[c] = by_travel[x] * travel[m] + by_rate[x] * rates[m];
      }
    }
  }

  // Writes the derivatives of a value to `own`: by joint positions, rates and accelerations at a constant
  // base attitude (3, n), then by a rotation of the whole system (3).
  void write_slopes(const Value& value, double* own) {
    const Residual& r = value.residual;
    const Index k = value.instant();
    const Instant<double>& at = instants_[k];
    const Column<double>* columns = columns_ + k * n_;
    for (int m = 0; m < 3; ++m) {
      const Strided& all = r.by[kJoints + m];
      for (int j = 0; j < n_; ++j) own[m * n_ + j] = all ? value(all, 0, j) : 0.0;
      if (r.by[kOwnJoint + m]) own[m * n_ + value.row] += value.by(kOwnJoint + m);
    }
    Vec3<double> moment = {};  // base axes
    for (int v = 0; v < kVectors; ++v) {
      const Strided& by = r.by[v];
      if (!by) continue;
      const Vec3<double> slope = {{value(by, 0), value(by, 1), value(by, 2)}};
      const Vec3<double> g = transposed(at.attitude) * slope;
      for (int j = 0; j < n_; ++j) own[j] += dot(columns[j].travel[v], g);
      for (int j = 0; v < kRated && j < n_; ++j) own[n_ + j] += dot(columns[j].rate[v], g);
      moment += v < kLevered ? cross(at.lever[v], g) : g;
      if (tumbles_ && v < kRated) moment += at.own_moment(v == 0 ? cross(at.lever[kTip], g) : g);
    }
    for (int j = 0; r.by[kEntropy] && j < n_; ++j) own[j] += value.by(kEntropy) * columns[j].entropy;
    if (r.by[kCoupling]) {
      double joints[kMostJoints], by_coupling[6 * kMostJoints], gradient[kMostJoints];
      Reader<double>{motions_.first + motion_ * K_ + k, motions_.stack}.next(joints, n_);
      for (int c = 0; c < 6; ++c) {
        for (int j = 0; j < n_; ++j) by_coupling[c * n_ + j] = value(r.by[kCoupling], c, j);
      }
      evaluate(tree_, joints, arm_);
      coupling_slopes(tree_, arm_, by_coupling, gradient);
      for (int j = 0; j < n_; ++j) own[j] += gradient[j];
    }
    const Vec3<double> turn = at.attitude * moment;
    std::copy_n(turn.v, 3, own + 3 * n_);
  }

  // Adds the derivative of one value by the control points to the batch of rows, and flushes a full batch.
  void add_row(const Value& value) {
    double own[3 * kMostJoints + 3];
    write_slopes(value, own);
    if (std::all_of(own, own + 3 * n_ + 3, [](double slope) { return slope == 0.0; })) return;
    const Index k = value.instant();
    const double *travel = map(0, k), *rates = map(1, k), *accelerations = map(2, k);
    const double *T = rotation_slopes(k), *turn = own + 3 * n_, *by_rates = own + n_,
                 *by_accelerations = by_rates + n_;
    double* row = rows_ + batched_ * size_;
    for (Index m = 0, c = 0; m < extent_[k]; ++m) {
      for (int j = 0; j < n_; ++j, ++c) {
        row[c] = turn[0] * T[c] + turn[1] * T[size_ + c] + turn[2] * T[2 * size_ + c];
        row[c] += own[j] * travel[m];
        row[c] += by_rates[j] * rates[m] + by_accelerations[j] * accelerations[m];
      }
    }
    weights_[batched_] = value.residual.weight[value.i];
    values_[batched_] = value(value.residual.value);
    width_ = std::max(width_, extent_[k] * n_);
    if (++batched_ == kBatch) flush();
  }

  // Adds the batch of rows to the gradient and to the lower triangle of the Hessian.
  void flush() {
    std::fill(weights_ + batched_, weights_ + kBatch, 0.0);
    const double *r0 = rows_, *r1 = r0 + size_, *r2 = r1 + size_, *r3 = r2 + size_;
    for (Index a = 0; a < width_; ++a) {
      const double w0 = weights_[0] * r0[a], w1 = weights_[1] * r1[a];
      const double w2 = weights_[2] * r2[a], w3 = weights_[3] * r3[a];
      gradient_[a] += w0 * values_[0] + w1 * values_[1] + w2 * values_[2] + w3 * values_[3];
      double* out = hessian_ + a * size_;
      for (Index b = 0; b <= a; ++b) out[b] += w0 * r0[b] + w1 * r1[b] + w2 * r2[b] + w3 * r3[b];
    }
    std::fill_n(rows_, kBatch * size_, 0.0);
    width_ = batched_ = 0;
  }

  // Adds a value that depends on one joint alone to this joint's entries of the gradient and of the lower
  // triangle of the Hessian.
  void add_alone(const Value& value) {
    const Index k = value.instant(), end = extent_[k];
    double* row = change_;
    std::fill_n(row, end, 0.0);
    for (int x = 0; x < 3; ++x) {
      const double slope = value.by(kOwnJoint + x);
      for (Index m = 0; slope != 0.0 && m < end; ++m) row[m] += slope * map(x, k)[m];
    }
    const Index first = std::find_if(row, row + end, [](double x) { return x != 0.0; }) - row;
    for (Index a = first; a < end; ++a) {
      const double weighted = value.residual.weight[value.i] * row[a];
      gradient_[a * n_ + value.row] += weighted * value(value.residual.value);
      double* out = hessian_ + (a * n_ + value.row) * size_ + value.row;
      for (Index b = first; b <= a; ++b) out[b * n_] += weighted * row[b];
    }
  }

  template <class Kind>
  Kind* take(int count) {
    double* taken = memory_;
    memory_ += static_cast<std::size_t>(count) * sizeof(Kind) / sizeof(double);
    return reinterpret_cast<Kind*>(taken);
  }

  const Tree& tree_;
  const MotionRows& motions_;
  const SplineMaps& spline_;
  const Quadrature& quadrature_;
  double* memory_;
  const bool tumbles_ = dot(motions_.momentum, motions_.momentum) > 0.0;
  const int n_ = tree_.n, size_ = spline_.size * n_, K_ = quadrature_.instants();
  Index* extent_ = take<Index>(K_);  // number of control points on which an instant depends
  Instant<double>* instants_ = take<Instant<double>>(K_);
  Column<double>* columns_ = take<Column<double>>(K_ * n_);
  double* rotation_slopes_ = take<double>(3 * size_ * K_);
  double* change_ = take<double>(3 * size_ * quadrature_.gauss);
  double *total_ = take<double>(3 * size_), *rows_ = take<double>(kBatch * size_);
  Arm<Pack> packs_;
  Arm<double> arm_;
  Index motion_ = 0, width_ = 0;
  int batched_ = 0;
  double weights_[kBatch], values_[kBatch] = {};
  double *gradient_ = nullptr, *hessian_ = nullptr;
};

}  // namespace ffsms
