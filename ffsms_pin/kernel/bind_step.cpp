// Bindings of step.hpp; the results are new arrays.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arrays.hpp"
#include "entropy.hpp"
#include "step.hpp"

namespace ffsms {

struct RootPose {
  Vec3<double> place;
  double x, y, z, w;  // the quaternion
};

namespace {

using Twist = Table<double, 6>;
// One limit, lower <= G u <= upper on the joint rates u, with G in any memory order, and the factor of the
// slack variable, 0 for a hard limit.
using Rows = std::tuple<nb::ndarray<const double, nb::ndim<2>, nb::device::cpu>, Vector, Vector, double>;

// The values of a step's state except the columns and V; see `StepState` in opt/step/state.py.
struct State {
  Vec3<double> tip, com;
  Momentum drift, tip_drift;  // twists
  Mat3<double> tip_rotation;
  double entropy;
};

// Returns the columns (3, 6, n) of the root's reaction, J* and J_m; V (n, n); and the numbers of a `State`.
nb::tuple step_state(const Tree& tree, const RootPose& root, const Vector& joints,
                     const std::optional<Momentum>& momentum) {
  const int n = tree.n;
  expect(joints.shape(0) == static_cast<Size>(n), "an array has a wrong shape");
  Arm<double> arm;
  evaluate(tree, joints.data(), arm);
  const auto [place, x, y, z, w] = root;
  const Mat3<double> R = {{{{1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)}},
                           {{2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)}},
                           {{2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)}}}};
  Out columns = new_array(3, 6, n), basis = new_array(n, n);
  double V[kMostJoints * kMostJoints], sigma[kMostJoints];
  Writer<double> write = {columns.data(), 1};
  for (const auto* own : {arm.root, arm.spin}) write.put(own, n);
  for (auto* base : {arm.jstar, arm.jstar_spin, arm.tip_velocity, arm.tip_spin}) {
    for (int j = 0; j < n; ++j) base[j] = R * base[j];  // inertial axes
    write.put(base, n);
  }
  // Singular values depend on the reference point, the base's centre of mass, and not on the axes.
  singular_values(6, n, arm.coupling, V, sigma);
  for (int i = 0; i < n * n; ++i) basis.data()[i] = V[i % n * n + i / n];
  const auto [linear, angular] = momentum.value_or(Momentum{});
  const Mat3<double> back = transposed(R);
  const Vec3<double> spin = arm.inverse * (back * angular);
  const Vec3<double> moving = (1.0 / tree.total_mass) * (back * linear) + cross(arm.com, spin);
  const State state = {place + R * arm.tip,  arm.com,
                       {moving, spin},       {R * (moving + cross(spin, arm.tip)), R * spin},
                       R * arm.tip_rotation, normalised_entropy(sigma, n)};
  return nb::make_tuple(columns, basis, array_of(state));
}

// Returns the least and greatest joint rates (2, n) at the step's end, from limits (4, n): lower, upper,
// velocity, acceleration.
Out rate_bounds(const Table<double, 4, -1>& limits, const Vector& joints, const Vector& rates, double dt) {
  const Size n = rates.shape(0);
  Out bounds = new_array(2, n);
  for (Size j = 0; j < n; ++j) {
    const double velocity = std::min(limits(2, j), kUnbounded), acceleration = limits(3, j);
    const double down = greatest_rate(joints(j) - limits(0, j), -rates(j), velocity, acceleration, dt);
    const double up = greatest_rate(limits(1, j) - joints(j), rates(j), velocity, acceleration, dt);
    bounds.data()[j] = -down;
    bounds.data()[n + j] = std::max(up, -down);  // if the joint cannot stop in time, both bounds are equal
  }
  return bounds;
}

// Returns A (m, n + 2), low and up of the constraints low <= A x <= up of the QP, from the rows of limits.
// The last two rows are s >= 0 and slack >= 0.
nb::tuple stacked_rows(const Matrix& V, const std::vector<Rows>& limits) {
  const Size n = V.shape(0), size = n + 2;
  std::vector<double> A, low, up;
  const auto add = [&](double least, double most) {
    low.push_back(least);
    up.push_back(most);
    A.resize(A.size() + size, 0.0);
    return &A[A.size() - size];
  };
  for (const auto& [G, lower, upper, softness] : limits) {
    // A soft limit has separate rows for its lower bounds and for its upper bounds.
    const bool soft = softness != 0.0;
    for (int side = 0; side < (soft ? 2 : 1); ++side) {
      for (Size r = 0; r < lower.shape(0); ++r) {
        const double least = soft && side == 1 ? -kUnbounded : lower(r);
        const double most = soft && side == 0 ? kUnbounded : upper(r);
        if (soft && !(least > -kUnbounded || most < kUnbounded)) continue;
        double* row = add(least, most);
        for (Size j = 0; j < n; ++j) {
          const double g = G(r, j);
          for (Size c = 0; g != 0.0 && c < n; ++c) row[c] += g * V(j, c);
        }
        row[n + 1] = side == 0 ? softness : -softness;
      }
    }
  }
  for (Size k : {n, n + 1}) add(0.0, kUnbounded)[k] = 1.0;
  Out rows = new_array(low.size(), size);
  std::copy(A.begin(), A.end(), rows.data());
  return nb::make_tuple(rows, array_of(low), array_of(up));
}

// Returns the desired motion, H (n + 2, n + 2) with g below it, and the constraints.
nb::tuple step_qp(const Vec3<double>& to_target, const std::optional<Mat3<double>>& rotation,
                  const Mat3<double>& attitude, const Table<double, 6, -1>& J, const Matrix& V,
                  const Vector& rates, const Twist& drift, const Vector& acceleration,
                  const Vec3<double>& side, double cosine, double time_left, double dt,
                  const StepWeights& weights, const std::vector<Rows>& limits) {
  const int n = static_cast<int>(rates.shape(0)), size = n + 2;
  const Size joints = rates.shape(0);
  expect(n <= kMostJoints && J.shape(1) == joints && V.size() == joints * joints,
         "an array has a wrong shape");
  expect_size(acceleration, joints);
  const StepArguments step = {n,         J.data(), V.data(), rates.data(), drift.data(), acceleration.data(),
                              to_target, side,     attitude, rotation,     cosine,       time_left,
                              dt};
  const DesiredMotion desired = desired_motion(step);
  Out objective = new_array(size + 1, size);
  std::fill_n(objective.data(), objective.size(), 0.0);
  add_objective(step, desired, weights, objective.data(), objective.data() + size * size);
  return nb::make_tuple(array_of(desired), objective, stacked_rows(V, limits));
}

// Returns the solution (x, z) of a QP with its active rows, |z| > tolerance, as equality constraints. Returns
// None if the equations are singular, or if the solution violates a row or the sign of a multiplier.
nb::object refined(const Matrix& H, const Vector& g, const Matrix& A, const Vector& low, const Vector& up,
                   const Vector& z, double tolerance) {
  const int n = static_cast<int>(g.shape(0)), rows = static_cast<int>(low.shape(0));
  std::vector<int> active;
  for (int r = 0; r < rows; ++r) {
    if (std::fabs(z(r)) > tolerance) active.push_back(r);
  }
  const int k = static_cast<int>(active.size()), size = n + k;
  std::vector<double> equations(size * (size + 1), 0.0), multipliers(rows, 0.0), x(n);
  const auto at = [&](int i, int j) -> double& { return equations[i * (size + 1) + j]; };
  for (int i = 0; i < n; ++i) {
    std::copy_n(H.data() + i * n, n, &at(i, 0));
    at(i, size) = -g(i);
  }
  for (int a = 0; a < k; ++a) {
    const int r = active[a];
    for (int i = 0; i < n; ++i) at(n + a, i) = at(i, n + a) = A(r, i);
    at(n + a, size) = z(r) > 0.0 ? up(r) : low(r);
  }
  if (!solve(equations.data(), size)) return nb::none();
  for (int i = 0; i < n; ++i) x[i] = at(i, size);
  for (int r = 0; r < rows; ++r) {
    const double reached = dot(A.data() + r * n, x.data(), n);
    // The condition is also true for NaN.
    if (!(std::max(low(r) - reached, reached - up(r)) <= 1e-9)) return nb::none();
  }
  for (int a = 0; a < k; ++a) {
    const double multiplier = at(n + a, size);
    if (!(multiplier * z(active[a]) >= 0.0)) return nb::none();
    multipliers[active[a]] = multiplier;
  }
  return nb::make_tuple(array_of(x), array_of(multipliers));
}

}  // namespace

void bind_step(nb::module_& m) {
  m.attr("ARRIVAL_POWER") = kArrivalPower;
  m.def("step_state", &step_state);
  m.def("rate_bounds", &rate_bounds);
  m.def("reference_speed", &reference_speed);
  m.def("ideal_cosine", &ideal_cosine);
  m.def("step_qp", &step_qp);
  m.def("refined", &refined);
}

}  // namespace ffsms
