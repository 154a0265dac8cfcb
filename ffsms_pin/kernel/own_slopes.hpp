// What residuals of a motion depend on at an instant: slopes by the joints and by a turn of everything.
//
// A residual says how it depends on the end effector, the base and the arm. The base reacts to the joints: it
// turns, and moves about the centre of mass. Here that turn stays, and what is left depends on the joint
// positions, rates and accelerations of the instant alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "slopes.hpp"

namespace ffsms {

// Numbers (component, joint, motion, instant); along an axis that an array does not have the stride is zero.
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

inline Vec3<double> vector(const Strided& of) { return {{of(0), of(1), of(2)}}; }

inline Mat3<double> matrix(const Strided& of) {
  Mat3<double> out;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[i][j] = of(i, j);
  }
  return out;
}

// What the sums have to know of motions of one robot.
struct ArmMotions {
  Strided joints, rates;       // (n, ..)
  Strided attitude, own_spin;  // of the base (3, 3, ..); what momentum adds to its spin, base axes (3, ..)
  Strided entropy_slope;       // of H_norm by C_bm (6, n, ..); absent where nothing depends on it
};

// Numbers at instants of motions: all of `count` instants of each motion, or `count` entries, each of one
// motion. Slopes are by what their names say, in inertial axes; what is absent does not matter.
struct Residual {
  std::ptrdiff_t count;
  const std::int64_t* instants;
  const std::int64_t* motion;  // null where dense
  const double* weight;
  Strided value, by_joints, by_rates, by_accelerations;
  Strided by_tip, by_turn, by_velocity, by_spin, by_base, by_base_turn, by_base_spin;
  Strided by_entropy, by_coupling;
};

// Slopes of one value: by the joints where the base stays, and by a turn of everything, inertial axes.
struct Own {
  double travel[kMostJoints], rates[kMostJoints], accelerations[kMostJoints];
  Vec3<double> turn;

  bool none(int n) const {
    double sum = std::fabs(turn[0]) + std::fabs(turn[1]) + std::fabs(turn[2]);
    for (int j = 0; j < n; ++j)
      sum += std::fabs(travel[j]) + std::fabs(rates[j]) + std::fabs(accelerations[j]);
    return sum == 0.0;
  }
};

inline Pack pack_of(const double* lanes) {
  Pack x;
  std::memcpy(&x, lanes, sizeof x);
  return x;
}

inline double lane(const Pack& x, int i) {
  double lanes[kLanes];
  std::memcpy(lanes, &x, sizeof x);
  return lanes[i];
}

inline Vec3<double> lane(const Vec3<Pack>& x, int i) {
  return {{lane(x[0], i), lane(x[1], i), lane(x[2], i)}};
}

// Slopes of values of one motion after the other.
class OwnSlopes {
 public:
  // Of one joint at one instant, base axes: columns of velocities, and slopes by its position at given rates.
  struct Column {
    Vec3<double> spin, jstar, carried,
        linear;  // of the base, of the end effector; its own axis; its momentum
    Vec3<double> spin_slope, jstar_slope, turning_slope;
    double entropy_slope;
  };

  // Of the robot at one instant, base axes.
  struct Instant {
    Mat3<double> attitude;
    Vec3<double> rho, base;                      // end effector and base from the centre of mass
    Vec3<double> velocity, base_spin, tip_spin;  // of the end effector, relative to the centre of mass
  };

  OwnSlopes(const Tree& tree, const ArmMotions& motions, int instants)
      : tree_(tree),
        motions_(motions),
        n_(tree.n),
        count_(instants),
        instants_(static_cast<std::size_t>(instants)),
        columns_(static_cast<std::size_t>(instants * tree.n)) {}

  void look_at_motion(std::ptrdiff_t motion) {
    motion_ = motion;
    for (int k = 0; k < count_; k += kLanes) look_at(k);
  }

  const Instant& instant(std::ptrdiff_t k) const { return instants_[k]; }
  const Column* columns(std::ptrdiff_t k) const { return &columns_[k * n_]; }

  // Slopes of value i of a residual, which is of this motion.
  const Own& slopes(const Residual& r, std::ptrdiff_t i) {
    const std::ptrdiff_t k = r.instants[i], s = r.motion == nullptr ? motion_ : 0;
    const Instant& at = instants_[k];
    const Column* columns = &columns_[k * n_];
    Vec3<double> moment = zero3<double>();  // base axes
    const Mat3<double> to_base = transposed(at.attitude);
    const auto inward = [&](const Strided& slope) { return to_base * vector(slope.at(s, i)); };
    const auto given = [&](const Strided& slope, double* out) {
      for (int j = 0; j < n_; ++j) out[j] = slope ? slope.at(s, i)(0, j) : 0.0;
    };
    double *travel = own_.travel, *rates = own_.rates;
    given(r.by_joints, travel);
    given(r.by_rates, rates);
    given(r.by_accelerations, own_.accelerations);
    if (r.by_tip) {
      const Vec3<double> g = inward(r.by_tip), lever = cross(at.rho, g);
      for (int j = 0; j < n_; ++j) travel[j] += dot(columns[j].jstar, g) - dot(columns[j].spin, lever);
      moment += lever;
    }
    if (r.by_velocity) {
      const Vec3<double> g = inward(r.by_velocity);
      for (int j = 0; j < n_; ++j) {
        rates[j] += dot(columns[j].jstar, g);
        travel[j] += dot(columns[j].jstar_slope, g);
      }
      moment += cross(at.velocity, g);
    }
    if (r.by_turn) {
      const Vec3<double> g = inward(r.by_turn);
      for (int j = 0; j < n_; ++j) travel[j] += dot(columns[j].carried, g);
      moment += g;
    }
    if (r.by_spin) {
      const Vec3<double> g = inward(r.by_spin);
      for (int j = 0; j < n_; ++j) {
        rates[j] += dot(columns[j].spin + columns[j].carried, g);
        travel[j] += dot(columns[j].spin_slope + columns[j].turning_slope, g);
      }
      moment += cross(at.tip_spin, g);
    }
    if (r.by_base) {
      const Vec3<double> g = inward(r.by_base);
      for (int j = 0; j < n_; ++j) travel[j] -= tree_.inverse_mass * dot(columns[j].linear, g);
      moment += cross(at.base, g);
    }
    if (r.by_base_turn) moment += inward(r.by_base_turn);
    if (r.by_base_spin) {
      const Vec3<double> g = inward(r.by_base_spin);
      for (int j = 0; j < n_; ++j) {
        rates[j] += dot(columns[j].spin, g);
        travel[j] += dot(columns[j].spin_slope, g);
      }
      moment += cross(at.base_spin, g);
    }
    if (r.by_entropy) {
      const double slope = r.by_entropy.at(s, i)(0);
      for (int j = 0; j < n_; ++j) travel[j] += slope * columns[j].entropy_slope;
    }
    if (r.by_coupling) add_coupling(motions_.joints.at(motion_, k), r.by_coupling.at(s, i));
    own_.turn = at.attitude * moment;
    return own_;
  }

 private:
  void add_coupling(const Strided& positions, const Strided& slope) {
    double joints[kMostJoints] = {}, by_coupling[6][kMostJoints], gradient[kMostJoints];
    for (int j = 0; j < n_; ++j) {
      joints[j] = positions(0, j);
      for (int c = 0; c < 6; ++c) by_coupling[c][j] = slope(c, j);
    }
    evaluate(tree_, joints, arm_);
    coupling_slopes(tree_, arm_, by_coupling, gradient);
    for (int j = 0; j < n_; ++j) own_.travel[j] += gradient[j];
  }

  // The arm at some instants side by side, and what residuals may ask of it there.
  void look_at(int begin) {
    const int count = std::min(kLanes, count_ - begin);
    const auto gathered = [&](const Strided& of, int c, int j) {
      double lanes[kLanes];
      for (int i = 0; i < kLanes; ++i) lanes[i] = of.at(motion_, begin + std::min(i, count - 1))(c, j);
      return pack_of(lanes);
    };
    Pack joints[kMostJoints] = {}, rates[kMostJoints] = {}, by_coupling[6][kMostJoints],
         entropy_slope[kMostJoints];
    Vec3<Pack> spin_slope[kMostJoints], jstar_slope[kMostJoints], turning_slope[kMostJoints];
    for (int j = 0; j < n_; ++j) {
      joints[j] = gathered(motions_.joints, 0, j);
      rates[j] = gathered(motions_.rates, 0, j);
      entropy_slope[j] = Pack{};
    }
    evaluate(tree_, joints, arms_);
    velocity_slopes(tree_, arms_, rates, spin_slope, jstar_slope);
    turning_slopes(tree_, arms_, rates, turning_slope);
    if (motions_.entropy_slope) {
      for (int c = 0; c < 6; ++c) {
        for (int j = 0; j < n_; ++j) by_coupling[c][j] = gathered(motions_.entropy_slope, c, j);
      }
      coupling_slopes(tree_, arms_, by_coupling, entropy_slope);
    }
    for (int i = 0; i < count; ++i) {
      const int k = begin + i;
      Instant& at = instants_[k];
      const Vec3<double> com = lane(arms_.com, i);
      at.attitude = matrix(motions_.attitude.at(motion_, k));
      at.rho = lane(arms_.tip, i) - com;
      at.base = tree_.base_com - com;
      at.base_spin = vector(motions_.own_spin.at(motion_, k));
      at.velocity = cross(at.base_spin, at.rho);
      Vec3<double> turning = zero3<double>();
      for (int j = 0; j < n_; ++j) {
        Column& column = columns_[k * n_ + j];
        column.spin = lane(arms_.spin[j], i);
        column.jstar = lane(arms_.jstar[j], i);
        column.carried = tree_.joints[j].moves_tip ? lane(arms_.axis[j], i) : zero3<double>();
        column.linear = lane(arms_.linear[j], i);
        column.spin_slope = lane(spin_slope[j], i);
        column.jstar_slope = lane(jstar_slope[j], i);
        column.turning_slope = lane(turning_slope[j], i);
        column.entropy_slope = lane(entropy_slope[j], i);
        const double rate = lane(rates[j], i);
        at.base_spin += rate * column.spin;
        at.velocity += rate * column.jstar;
        turning += rate * column.carried;
      }
      at.tip_spin = at.base_spin + turning;
    }
  }

  const Tree& tree_;
  const ArmMotions& motions_;
  const int n_, count_;
  std::ptrdiff_t motion_ = 0;
  std::vector<Instant> instants_;
  std::vector<Column> columns_;
  Arm<Pack> arms_;
  Arm<double> arm_;
  Own own_;
};

}  // namespace ffsms
