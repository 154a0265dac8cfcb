// Gauss-Newton sums of whole motions: from slopes of residuals by what moves to the gradient and the Hessian
// by the control points of the joints' spline, flattened with the joints last.
//
// A residual says how it depends on the end effector, the base and the arm. The base reacts to the joints: it
// turns, and moves about the centre of mass. So a residual depends on the joint positions, rates and
// accelerations of its instant, and on a turn of everything about the centre of mass. That turn is the
// integral of the change of the base's angular velocity: the same quadrature that gives the attitude gives
// its slopes by the control points, one interval after the other.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "rollout.hpp"
#include "slopes.hpp"

namespace ffsms {

// Numbers (component, joint, motion, instant); along an axis that an array does not have the stride is zero.
struct Strided {
  const double* data = nullptr;
  std::ptrdiff_t component = 0, joint = 0, motion = 0, instant = 0;

  explicit operator bool() const { return data != nullptr; }

  double operator()(std::ptrdiff_t s, std::ptrdiff_t k, int c = 0, int j = 0) const {
    return data[s * motion + k * instant + c * component + j * joint];
  }
};

// What residuals have slopes by. First vectors, inertial axes: three that joint rates change as well, two
// more that a turn of everything takes along, and two turns. Of a number for each joint, slopes by it alone
// are "own".
constexpr const char* kNames[] = {"by_velocity",      "by_spin",          "by_base_spin", "by_tip",
                                  "by_base",          "by_turn",          "by_base_turn", "by_joints",
                                  "by_rates",         "by_accelerations", "own_joint",    "own_rate",
                                  "own_acceleration", "by_entropy",       "by_coupling"};
constexpr int kBaseSpin = 2, kRated = 3, kLevered = 5, kVectors = 7;
constexpr int kJoints = 7, kOwnJoint = 10, kEntropy = 13, kCoupling = 14, kSlopes = 15;

// A number at `count` instants of each motion, or `count` entries, each of one motion. Absent slopes are
// zero.
struct Residual {
  std::ptrdiff_t count;
  const std::int64_t *instants, *motion;  // the latter null where dense
  const double* weight;
  int joint;  // its own
  Strided value, by[kSlopes];

  // Whether it depends on its own joint and on nothing else.
  bool alone() const {
    const auto there = [](const Strided& slope) { return static_cast<bool>(slope); };
    return std::none_of(by, by + kOwnJoint, there) && std::none_of(by + kEntropy, by + kSlopes, there);
  }
};

// Dense arrays of motions; the entropy's slopes by C_bm may be absent.
struct MotionArrays {
  const double *joints, *rates, *attitude, *own_spin, *entropy_slope;  // (n), (n), (3, 3), (3), (6, n)
  std::ptrdiff_t stack;                                                // numbers in a row
};

// Maps from M control points of one joint to its travel, rate and acceleration at all instants, (K, M).
struct SplineMaps {
  int size;
  const double* map[3];
};

// The robot at one instant, base axes: vectors that turn with everything; how each joint moves vectors, by
// its position and by its rate; and its slope of the entropy.
template <class T>
struct Instant {
  Vec3<T> lever[kLevered];
  Mat3<T> attitude;
};
template <class T>
struct Column {
  Vec3<T> travel[kVectors], rate[kRated];
  T entropy;
};

// One lane of what is made of packs alone.
template <template <class> class Of, class T>
Of<double> lane(const Of<T>& packs, int i) {
  Of<double> out;
  Reader<double>{reinterpret_cast<const double*>(&packs) + i, sizeof(T) / sizeof(double)}.next(&out);
  return out;
}

class Sums {
 public:
  Sums(const Tree& tree, const MotionArrays& motions, const SplineMaps& spline, const Quadrature& quadrature)
      : tree_(tree),
        motions_(motions),
        spline_(spline),
        quadrature_(quadrature),
        n_(tree.n),
        size_(spline.size * tree.n),
        first_(static_cast<std::size_t>(quadrature.instants())),
        extent_(first_.size()),
        instants_(first_.size()),
        columns_(first_.size() * static_cast<std::size_t>(n_)),
        turned_(3 * first_.size() * static_cast<std::size_t>(size_)),
        change_(static_cast<std::size_t>(3 * quadrature.gauss * size_)),
        total_(static_cast<std::size_t>(3 * size_)),
        rows_(static_cast<std::size_t>(kBatch * size_)) {
    find_extents();
  }

  // Sums of one motion, added to a gradient (M n,) and a Hessian (M n, M n) of zeros.
  void add(std::ptrdiff_t motion, const std::vector<Residual>& residuals, double* gradient, double* hessian) {
    gradient_ = gradient;
    hessian_ = hessian;
    motion_ = motion;
    int k = 0;
    for (; k + kLanes <= quadrature_.instants(); k += kLanes) look_at(k, packs_);
    for (; k < quadrature_.instants(); ++k) look_at(k, arm_);
    sweep();
    for (const Residual& residual : residuals) {
      const bool alone = residual.alone();
      for (std::ptrdiff_t i = 0; i < residual.count; ++i) {
        if (residual.weight[i] == 0.0 || (residual.motion && residual.motion[i] != motion)) continue;
        if (alone) {
          add_alone(residual, i);
        } else {
          add_row(residual, i);
        }
      }
    }
    flush();
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
        const bool now = spline_.map[1][at] != 0.0 || spline_.map[2][at] != 0.0;
        if (now) first = std::min(first, m);
        if (now || spline_.map[0][at] != 0.0) end = m + 1;
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

  // The arm at an instant, or at those of a pack, and what residuals may ask of it there.
  template <class T>
  void look_at(int begin, Arm<T>& arm) {
    const auto read = [&](const double* from, T* values, int rows) {
      from += motion_ * quadrature_.instants() + begin;
      for (int i = 0; i < rows; ++i) std::memcpy(&values[i], from + i * motions_.stack, sizeof(T));
    };
    T joints[kMostJoints], rates[kMostJoints], by_coupling[6 * kMostJoints], by_entropy[kMostJoints] = {};
    Vec3<T> spin_slope[kMostJoints], tip_slope[kMostJoints], turning_slope[kMostJoints];
    Mat3<T> attitude;
    Vec3<T> base_spin;
    read(motions_.joints, joints, n_);
    read(motions_.rates, rates, n_);
    read(motions_.attitude, &attitude[0][0], 9);
    read(motions_.own_spin, base_spin.v, 3);
    evaluate(tree_, joints, arm);
    velocity_slopes(tree_, arm, rates, spin_slope, tip_slope);
    turning_slopes(tree_, arm, rates, turning_slope);
    if (motions_.entropy_slope) {
      read(motions_.entropy_slope, by_coupling, 6 * n_);
      coupling_slopes(tree_, arm, by_coupling, by_entropy);
    }
    const int lanes = sizeof(T) / sizeof(double);
    const Vec3<T> rho = arm.tip - arm.com, none = {};
    Vec3<T> velocity = cross(base_spin, rho), turning = none;
    for (int j = 0; j < n_; ++j) {
      const Vec3<T> carried = tree_.joints[j].moves_tip ? arm.axis[j] : none, &spin = arm.spin[j];
      const Column<T> column = {
          {tip_slope[j], spin_slope[j] + turning_slope[j], spin_slope[j], arm.jstar[j] - cross(spin, rho),
           -tree_.inverse_mass * arm.linear[j], carried, none},
          {arm.jstar[j], spin + carried, spin},
          by_entropy[j]};
      for (int i = 0; i < lanes; ++i) columns_[(begin + i) * n_ + j] = lane(column, i);
      base_spin += rates[j] * spin;
      velocity += rates[j] * arm.jstar[j];
      turning += rates[j] * carried;
    }
    const Instant<T> at = {{velocity, base_spin + turning, base_spin, rho, Vec3<T>(tree_.base_com) - arm.com},
                           attitude};
    for (int i = 0; i < lanes; ++i) {
      instants_[begin + i] = lane(at, i);
    }
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
    const double *travel = spline_.map[0] + k * spline_.size, *rates = spline_.map[1] + k * spline_.size;
    for (int j = 0; j < n_; ++j) {
      const Column<double>& column = columns_[k * n_ + j];
      const Vec3<double> by_travel = instants_[k].attitude * column.travel[kBaseSpin];
      const Vec3<double> by_rate = instants_[k].attitude * column.rate[kBaseSpin];
      for (int x = 0; x < 3; ++x) {
        double* row = out + x * size_;
        for (int m = 0, c = j; c < wide; ++m, c += n_)
          row[c] = by_travel[x] * travel[m] + by_rate[x] * rates[m];
      }
    }
  }

  // Slopes of one value: by the joints' travel, rates and accelerations where the base stays, and by a turn.
  struct Own {
    double by[3][kMostJoints];
    Vec3<double> turn;
  };

  void find_slopes(const Residual& r, std::ptrdiff_t i, Own& own) {
    const std::ptrdiff_t k = r.instants[i], s = r.motion ? 0 : motion_;
    const Column<double>* columns = &columns_[k * n_];
    const Mat3<double> to_base = transposed(instants_[k].attitude);
    for (int m = 0; m < 3; ++m) {
      const Strided &all = r.by[kJoints + m], &alone = r.by[kOwnJoint + m];
      for (int j = 0; j < n_; ++j) own.by[m][j] = all ? all(s, i, 0, j) : 0.0;
      if (alone) own.by[m][r.joint] += alone(s, i);
    }
    Vec3<double> moment = Vec3<double>{};  // base axes
    for (int v = 0; v < kVectors; ++v) {
      const Strided& by = r.by[v];
      if (!by) continue;
      const Vec3<double> g = to_base * Vec3<double>{{by(s, i, 0), by(s, i, 1), by(s, i, 2)}};
      for (int j = 0; j < n_; ++j) own.by[0][j] += dot(columns[j].travel[v], g);
      for (int j = 0; v < kRated && j < n_; ++j) own.by[1][j] += dot(columns[j].rate[v], g);
      moment += v < kLevered ? cross(instants_[k].lever[v], g) : g;
    }
    if (r.by[kEntropy]) {
      for (int j = 0; j < n_; ++j) own.by[0][j] += r.by[kEntropy](s, i) * columns[j].entropy;
    }
    if (r.by[kCoupling]) {
      double joints[kMostJoints], by_coupling[6 * kMostJoints], gradient[kMostJoints];
      for (int j = 0; j < n_; ++j) {
        joints[j] = motions_.joints[j * motions_.stack + motion_ * quadrature_.instants() + k];
        for (int c = 0; c < 6; ++c) by_coupling[c * n_ + j] = r.by[kCoupling](s, i, c, j);
      }
      evaluate(tree_, joints, arm_);
      coupling_slopes(tree_, arm_, by_coupling, gradient);
      for (int j = 0; j < n_; ++j) own.by[0][j] += gradient[j];
    }
    own.turn = instants_[k].attitude * moment;
  }

  // The row of one value by the control points, kept until there are enough for a pass.
  void add_row(const Residual& r, std::ptrdiff_t i) {
    Own own;
    find_slopes(r, i, own);
    const auto none = [&](const double* x, int count) {
      return std::all_of(x, x + count, [](double one) { return one == 0.0; });
    };
    if (none(own.by[0], n_) && none(own.by[1], n_) && none(own.by[2], n_) && none(own.turn.v, 3)) return;
    const std::ptrdiff_t k = r.instants[i];
    const double *travel = spline_.map[0] + k * spline_.size, *rates = spline_.map[1] + k * spline_.size;
    const double *accelerations = spline_.map[2] + k * spline_.size, *T = turned(k);
    const int end = extent_[k], wide = end * n_;
    double* row = &rows_[waiting_ * size_];
    for (int c = 0; c < wide; ++c) {
      row[c] = own.turn[0] * T[c] + own.turn[1] * T[size_ + c] + own.turn[2] * T[2 * size_ + c];
    }
    for (int m = 0, c = 0; m < end; ++m) {
      for (int j = 0; j < n_; ++j, ++c) row[c] += own.by[0][j] * travel[m];
    }
    for (int m = first_[k], c = m * n_; m < end; ++m) {
      for (int j = 0; j < n_; ++j, ++c) row[c] += own.by[1][j] * rates[m] + own.by[2][j] * accelerations[m];
    }
    weights_[waiting_] = r.weight[i];
    values_[waiting_] = r.value(r.motion ? 0 : motion_, i);
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

  // What depends on one joint alone: that joint's entries of the gradient and the lower triangle.
  void add_alone(const Residual& r, std::ptrdiff_t i) {
    const std::ptrdiff_t k = r.instants[i], s = r.motion ? 0 : motion_;
    const int first = r.by[kOwnJoint] ? 0 : first_[k], end = extent_[k];
    double* row = rows_.data() + waiting_ * size_;
    std::fill(row, row + end, 0.0);
    for (int x = 0; x < 3; ++x) {
      const double slope = r.by[kOwnJoint + x] ? r.by[kOwnJoint + x](s, i) : 0.0;
      const double* map = spline_.map[x] + k * spline_.size;
      for (int m = first; m < end && slope != 0.0; ++m) row[m] += slope * map[m];
    }
    for (int a = first; a < end; ++a) {
      const double weighted = r.weight[i] * row[a];
      gradient_[a * n_ + r.joint] += weighted * r.value(s, i);
      double* out = hessian_ + (a * n_ + r.joint) * size_ + r.joint;
      for (int b = first; b <= a; ++b) out[b * n_] += weighted * row[b];
    }
  }

  const Tree& tree_;
  const MotionArrays& motions_;
  const SplineMaps& spline_;
  const Quadrature& quadrature_;
  const int n_, size_;
  std::vector<int> first_, extent_;  // of the control points that matter at an instant
  std::vector<Instant<double>> instants_;
  std::vector<Column<double>> columns_;
  std::vector<double> turned_, change_, total_, rows_;
  Arm<Pack> packs_;
  Arm<double> arm_;
  std::ptrdiff_t motion_ = 0;
  double weights_[kBatch], values_[kBatch];
  int wide_[kBatch], waiting_ = 0;
  double *gradient_ = nullptr, *hessian_ = nullptr;
};

}  // namespace ffsms
