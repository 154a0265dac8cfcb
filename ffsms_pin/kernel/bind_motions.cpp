// Bindings for whole motions: the base's attitude, the Gauss-Newton sums, and the Cholesky factor. Shapes are
// checked here.
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arrays.hpp"
#include "cholesky.hpp"
#include "sums.hpp"

namespace ffsms {
namespace {

using Slope = nb::ndarray<const double, nb::device::cpu>;
using InOut = nb::ndarray<double, nb::c_contig, nb::device::cpu>;  // results are added to it

// Arguments from Python.
using QuadratureArguments = std::tuple<In, Matrix, int>;  // integral_to_points, integral_over, late
// A residual: instants, motions, weights, values, slopes by name.
using ResidualArguments =
    std::tuple<Indices, std::optional<Indices>, Vector, Slope, std::map<std::string, Slope>>;

[[noreturn]] void wrong_shape(const std::string& name) {
  throw std::invalid_argument(name + " of a residual or a motion has a wrong shape");
}

// Returns an array with axes of the given sizes. A size of zero stands for a missing axis. An axis of length
// 1 is repeated.
Strided strided(const Slope& array, const Size (&sizes)[5], const char* name) {
  Strided out = {array.data(), {}};
  Size axis = array.ndim();
  for (int i = 5; i-- > 0;) {
    if (sizes[i] == 0) continue;
    if (axis-- == 0 || (array.shape(axis) != sizes[i] && array.shape(axis) != 1)) wrong_shape(name);
    if (array.shape(axis) != 1) out.step[i] = array.stride(axis);
  }
  if (axis != 0) wrong_shape(name);
  return out;
}

// Checks that an array has `count` indices below `end`, and returns them.
const Index* checked(const Indices& array, Size count, Size end, const char* name) {
  if (array.shape(0) != count) wrong_shape(name);
  for (Size i = 0; i < count; ++i) {
    if (array(i) < 0 || array(i) >= static_cast<Index>(end)) wrong_shape(name);
  }
  return array.data();
}

// Returns attitudes (9, 2 N + 1) at the nodes and in the middles of N steps, from angular velocities
// (3, 2 N + 1) in base axes at the same instants. A whole step uses Simpson's rule and one commutator. The
// first half of a step uses the parabola through the same three points.
Out attitudes(const Mat3<double>& start, const Table<double, 3, -1>& omega, double dt) {
  const Size count = omega.shape(1);
  Out out = new_array(9, count);
  const auto put = [&](const Mat3<double>& R, Size k) { Writer<double>{out.data() + k, count}.put(&R); };
  Mat3<double> R = start;
  put(R, 0);
  for (Size k = 0; k + 2 < count; k += 2) {
    Vec3<double> w[3];
    for (Size i = 0; i < 3; ++i) Reader<double>{omega.data() + k + i, count}.next(&w[i]);
    put(R * exp3((dt / 24.0) * (5.0 * w[0] + 8.0 * w[1] - w[2]) + (dt * dt / 48.0) * cross(w[0], w[1])),
        k + 1);
    R = R * exp3((dt / 6.0) * (w[0] + 4.0 * w[1] + w[2]) + (dt * dt / 12.0) * cross(w[0], w[2]));
    put(R, k + 2);
  }
  return out;
}

// Integrates a system with a total momentum under joint accelerations (n, N) that are constant within each
// step of length dt. Returns the states (12 + 2 n, N + 1) at the nodes, the first equal to `start`. A state
// has the attitude and position of the root, then the joint positions and rates.
Out roll_out(const Tree& tree, const Vector& start, const Matrix& accelerations, const Momentum& momentum,
             double dt) {
  const int n = tree.n, rows = 12 + 2 * n;
  const Size steps = accelerations.shape(1), nodes = steps + 1;
  expect(accelerations.shape(0) == static_cast<Size>(n), "an array has a wrong shape");
  expect_size(start, static_cast<Size>(rows));
  Out out = new_array(rows, nodes);
  Writer<double>{out.data(), nodes}.put(start.data(), rows);
  Placed root;
  double q[kMostJoints] = {}, u[kMostJoints] = {}, a[kMostJoints] = {};
  Reader<double> read = {start.data(), 1};
  read.next(&root);
  read.next(q, n);
  read.next(u, n);
  const auto half_a_step = [&] {
    for (int j = 0; j < n; ++j) {
      q[j] += 0.5 * dt * (u[j] + 0.25 * dt * a[j]);
      u[j] += 0.5 * dt * a[j];
    }
  };
  Arm<double> arm;
  Spin first = spin_at(tree, q, u, arm);
  Vec3<double> com = root.origin + root.turn * arm.com;
  for (Size k = 0; k < steps; ++k) {
    Reader<double>{accelerations.data() + k, steps}.next(a, n);
    half_a_step();
    const Spin middle = spin_at(tree, q, u, arm);
    half_a_step();
    const Spin last = spin_at(tree, q, u, arm);
    root.turn = runge_kutta_step(root.turn, first, middle, last, momentum.angular, dt);
    com += dt * tree.inverse_mass * momentum.linear;
    root.origin = com - root.turn * arm.com;
    Writer<double> write = {out.data() + k + 1, nodes};
    write.put(&root);
    write.put(q, n);
    write.put(u, n);
    first = last;
  }
  return out;
}

Quadrature quadrature_of(const QuadratureArguments& arguments) {
  const auto& [to_points, over, late] = arguments;
  const Size intervals = over.shape(0), gauss = over.shape(1);
  expect(gauss <= kMostGauss, "the kernel takes at most 8 Gauss points per interval");
  expect_size(to_points, intervals * gauss * gauss);
  return {static_cast<int>(intervals), static_cast<int>(gauss), late, to_points.data(), over.data()};
}

// Returns rows (12, S K) along S motions of a spline: attitudes (9) of the base, and the part of its angular
// velocity (3) due to the angular momentum. The arguments are the angular velocity due to the joint rates
// (3, S, K), and the inverse of the system's inertia (3, 3, S, K).
Out spline_attitudes(const QuadratureArguments& quadrature, const In& omega, const In& inverse,
                     const Mat3<double>& start, const Vec3<double>& momentum) {
  const Quadrature rule = quadrature_of(quadrature);
  const Size K = static_cast<Size>(rule.instants()), count = omega.size() / 3;
  expect(omega.size() == 3 * count && count % K == 0 && inverse.size() == 9 * count,
         "an array has a wrong shape");
  Out out = new_array(12, count);
  for (Size begin = 0; begin < count; begin += K) {
    std::vector<BaseRotation> at(K);
    for (Size k = 0; k < K; ++k) {
      Reader<double>{omega.data() + begin + k, count}.next(&at[k].reaction);
      Reader<double>{inverse.data() + begin + k, count}.next(&at[k].inverse);
    }
    base_attitudes(rule, start, momentum, at.data());
    for (Size k = 0; k < K; ++k) {
      Writer<double> write = {out.data() + begin + k, count};
      write.put(&at[k].attitude);
      write.put(&at[k].own);
    }
  }
  return out;
}

Residual residual_of(const ResidualArguments& arguments, Size n, Size motions, Size instants) {
  const auto& [at, motion, weight, value, slopes] = arguments;
  const Size count = weight.size(), S = motion ? 1 : motions, rows = value.ndim() == 3 ? value.shape(0) : 0;
  Residual out = {};
  out.rows = std::max<Index>(static_cast<Index>(rows), 1);
  out.count = static_cast<Index>(count);
  out.instants = checked(at, count, instants, "instants");
  out.motion = motion ? checked(*motion, count, motions, "motion") : nullptr;
  out.weight = weight.data();
  if (count == 0) return out;
  out.value = strided(value, {rows, 0, 0, S, count}, "value");
  for (int i = 0; i < kSlopes; ++i) {
    const auto slope = slopes.find(kNames[i]);
    if (slope == slopes.end()) continue;
    const bool all = (i >= kVectors && i < kOwnJoint) || i == kCoupling;
    const Size components = i < kVectors ? 3 : i == kCoupling ? 6 : 0;
    out.by[i] = strided(slope->second, {rows, components, all ? n : 0, S, count}, kNames[i]);
    expect(i < kOwnJoint || i >= kEntropy || rows == n, "own slopes need a residual with one row per joint");
  }
  return out;
}

// Adds the sums of selected motions to gradients (S, M n) and Hessians (S, M n, M n). `motions` (rows, S, K)
// has S motions, and `chosen` has the indices of the selected motions.
void sums(const Tree& tree, const Table<double, 3, -1, -1>& maps, const QuadratureArguments& quadrature,
          const Table<double, -1, -1, -1>& motions, const std::vector<ResidualArguments>& residuals,
          const Indices& chosen, const InOut& gradient, const InOut& hessian,
          const std::optional<Vec3<double>>& momentum) {
  const Quadrature rule = quadrature_of(quadrature);
  const Size n = static_cast<Size>(tree.n), K = static_cast<Size>(rule.instants()), S = motions.shape(1);
  const Size size = n * maps.shape(2), rows = motions.shape(0);
  const bool entropy = rows == 8 * n + 12;
  if (maps.shape(1) != K || motions.shape(2) != K || !(entropy || rows == 2 * n + 12))
    wrong_shape("an array");
  const SplineMaps spline = {static_cast<int>(maps.shape(2)), maps.data()};
  std::vector<Residual> values;
  for (const auto& argument : residuals) values.push_back(residual_of(argument, n, S, K));
  checked(chosen, chosen.shape(0), S, "a chosen motion");
  expect_size(gradient, S * size);
  expect_size(hessian, S * size * size);
  // The memory (about 1 MB) is kept between calls, because its allocation would take as long as the sums.
  thread_local std::vector<double> memory;
  memory.resize(std::max(memory.size(), Sums::needed(tree, spline, rule)));
  const MotionRows all = {motions.data(), S * K, entropy, momentum.value_or(Vec3<double>{})};
  Sums sum(tree, all, spline, rule, memory.data());
  for (Size i = 0; i < chosen.shape(0); ++i) {
    const Size s = static_cast<Size>(chosen(i));
    sum.add(chosen(i), values, gradient.data() + s * size, hessian.data() + s * size * size);
  }
}

nb::object cholesky_factor(const Matrix& matrix) {
  const Size n = matrix.shape(0);
  expect(matrix.shape(1) == n, "an array has a wrong shape");
  Out factor = new_array(n, n);
  std::copy_n(matrix.data(), n * n, factor.data());
  if (!cholesky(factor.data(), static_cast<int>(n))) return nb::none();
  return nb::cast(factor);
}

Out solved_lower(const Matrix& factor, const Matrix& right) {
  const Size n = factor.shape(0), count = right.shape(1);
  expect(factor.shape(1) == n && right.shape(0) == n, "an array has a wrong shape");
  Out solution = new_array(n, count);
  std::copy_n(right.data(), n * count, solution.data());
  solve_lower(factor.data(), solution.data(), static_cast<int>(n), static_cast<int>(count));
  return solution;
}

Out solved_upper(const Matrix& factor, const Vector& right) {
  const Size n = factor.shape(0);
  expect(factor.shape(1) == n && right.shape(0) == n, "an array has a wrong shape");
  Out solution = array_of(right.data(), n);
  solve_upper(factor.data(), solution.data(), static_cast<int>(n));
  return solution;
}

}  // namespace

void bind_motions(nb::module_& m) {
  m.def("attitudes", &attitudes);
  m.def("roll_out", &roll_out);
  m.def("spline_attitudes", &spline_attitudes);
  // noconvert: results must be added to the caller's arrays, not to copies.
  m.def("sums", &sums, nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(),
        nb::arg().noconvert(), nb::arg().noconvert(), nb::arg() = nb::none());
  m.def("cholesky", &cholesky_factor);
  m.def("solve_lower", &solved_lower);
  m.def("solve_upper", &solved_upper);
}

}  // namespace ffsms
