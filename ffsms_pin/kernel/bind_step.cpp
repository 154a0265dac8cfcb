// Python's view of step.hpp: plain arrays in, new arrays out.
#include <nanobind/stl/optional.h>

#include <optional>
#include <vector>

#include "arm.hpp"
#include "arrays.hpp"
#include "step.hpp"

namespace ffsms {
namespace {

Schedule schedule_of(const Vector& s, double time_left, double dt) {
  return {s(0), s(1), s(2), s(3), time_left, dt};
}

Out array_of(const Vec3<double>& vector) {
  Out out = new_array(3);
  std::copy_n(vector.v, 3, out.data());
  return out;
}

Out zeros(int size) {
  Out out = new_array(size);
  std::fill_n(out.data(), size, 0.0);
  return out;
}

// What a step is written from, of a root pose (x, y, z, quaternion): see opt/step/state.py. First columns
// (6, n), reaction, J*, J_m and C_bm; then places and twists, and the end effector's attitude.
nb::tuple step_state(const Tree& tree, const Vector& root, const Vector& joints,
                     const std::optional<Vector>& momentum) {
  const int n = tree.n;
  expect(root.shape(0) == 7 && joints.shape(0) == static_cast<Size>(n), "an array has a wrong shape");
  Arm<double> arm;
  evaluate(tree, joints.data(), arm);
  const double x = root(3), y = root(4), z = root(5), w = root(6);
  const Mat3<double> R = {{{1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)},
                           {2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)},
                           {2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)}}};
  Out columns = new_array(4, 6, n), more = new_array(27);
  for (int j = 0; j < n; ++j) {
    Writer write = {columns.data() + j, static_cast<Size>(n)};
    const Vec3<double> turning = tree.joints[j].moves_tip ? arm.axis[j] : zero3<double>();
    for (const Vec3<double>& column : {arm.root[j], arm.spin[j], R * arm.jstar[j],
                                       R * (arm.spin[j] + turning), R * arm.tip_velocity[j], R * turning}) {
      write.put(&column, 1);
    }
    for (const auto& row : arm.coupling) write.put(&row[j], 1);
  }
  Vec3<double> spin = zero3<double>(), moving = spin;
  if (momentum) {
    const Mat3<double> back = transposed(R);
    spin = arm.inverse * (back * vector_at(momentum->data() + 3));
    moving = (1.0 / tree.total_mass) * (back * vector_at(momentum->data())) + cross(arm.com, spin);
  }
  Writer write = {more.data(), 1};
  for (const Vec3<double>& one : {vector_at(root.data()) + R * arm.tip, arm.com, moving, spin,
                                  R * (moving + cross(spin, arm.tip)), R * spin}) {
    write.put(&one, 1);
  }
  const Mat3<double> attitude = R * arm.tip_rotation;
  write.put(&attitude, 1);
  return nb::make_tuple(columns, more);
}

// Least and greatest rates at the step's end, of limits (4, n): lower, upper, velocity, acceleration.
nb::tuple rate_bounds(const Matrix& limits, const Vector& joints, const Vector& rates, double dt) {
  const Size n = rates.shape(0);
  Out least = new_array(n), greatest = new_array(n);
  for (Size j = 0; j < n; ++j) {
    const double velocity = std::min(limits(2, j), kUnbounded), acceleration = limits(3, j);
    const double down = greatest_rate(joints(j) - limits(0, j), -rates(j), velocity, acceleration, dt);
    const double up = greatest_rate(limits(1, j) - joints(j), rates(j), velocity, acceleration, dt);
    least.data()[j] = -down;
    greatest.data()[j] = std::max(up, -down);  // where there is no room to brake, the lower one is both
  }
  return nb::make_tuple(least, greatest);
}

// (towards, direction, speed, side), or None where the end effector has arrived.
nb::object wanted_motion(const Vector& constants, const Vector& way, const Matrix& J, const Vector& rates,
                         const Vector& drift, const Vector& acceleration, const Vector& side, double cosine,
                         double time_left, double dt) {
  const Schedule schedule = schedule_of(constants, time_left, dt);
  const int n = static_cast<int>(rates.shape(0));
  expect(n <= kMostJoints, "the kernel takes 1 to 64 joints");
  const Vec3<double> left = vector_at(way.data()), hint = vector_at(side.data());
  const double distance = std::sqrt(dot(left, left));
  if (distance < 1e-12) return nb::none();
  const Vec3<double> towards = left / distance;
  Vec3<double> velocity;
  for (int i = 0; i < 3; ++i) velocity[i] = dot(J.data() + i * n, rates.data(), n) + drift(i);
  const bool sided = dot(hint, hint) > 0.0;
  const Vec3<double> lateral = lateral_direction(towards, sided ? hint : velocity);
  const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
  const Vec3<double> direction = cosine * towards + sine * lateral;
  double gradient[kMostJoints];
  for (int j = 0; j < n; ++j) gradient[j] = dot(direction, Vec3<double>{{J(0, j), J(1, j), J(2, j)}});
  // A path at a constant angle to the direction of the target is 1 / cos longer than the straight one.
  const double along = std::max(cosine, schedule.least_approach);
  const double speed =
      schedule.reached(distance / along, dot(velocity, direction), gradient, acceleration.data(), n);
  const double most = schedule.nearing * distance * along / dt;
  return nb::make_tuple(array_of(towards), array_of(direction), std::min(speed, most), array_of(lateral));
}

double scheduled(const Vector& constants, double left, double speed, const Vector& gradient,
                 const Vector& acceleration, double time_left, double dt) {
  const int n = static_cast<int>(gradient.shape(0));
  return schedule_of(constants, time_left, dt).reached(left, speed, gradient.data(), acceleration.data(), n);
}

double reference_speed(const Vector& constants, double path_left, double speed, double time_left, double dt) {
  return schedule_of(constants, time_left, dt).reference(path_left, speed);
}

// H (n + 2, n + 2) and g (n + 2,) of direction, speed, effort, change and slack.
nb::tuple objective(const Matrix& J, const Matrix& V, const Vector& rates, const Vector& drift,
                    const Vector& direction, double speed, const Vector& weights, bool plain_effort) {
  const int n = static_cast<int>(rates.shape(0)), size = n + 2;
  const double effort = plain_effort ? weights(2) : 0.0, change = weights(3), slack = weights(4);
  expect(n <= kMostJoints, "the kernel takes 1 to 64 joints");
  Out H = new_array(size, size), linear = zeros(size);
  std::fill_n(H.data(), size * size, 0.0);
  double *g = linear.data(), row[kMostJoints + 1];
  for (int r = 0; r < 3; ++r) {  // J V alpha + drift is to be along the direction
    times_basis(J.data() + r * n, V.data(), n, row);
    row[n] = -direction(r);
    for (int i = 0; i <= n; ++i) {
      const double weighted = weights(0) * row[i];
      g[i] += weighted * drift(r);
      for (int j = 0; j <= n; ++j) H.data()[i * size + j] += weighted * row[j];
    }
  }
  // V turns without stretching, so that |u| = |alpha|: effort and change are diagonal in alpha, too.
  for (int i = 0; i < n; ++i) {
    H.data()[i * size + i] += change + effort;
    for (int j = 0; j < n; ++j) g[i] -= change * rates(j) * V(j, i);
  }
  H.data()[n * size + n] += weights(1);
  g[n] -= weights(1) * speed;
  H.data()[(n + 1) * size + n + 1] += slack;
  g[n + 1] += slack;
  return nb::make_tuple(H, linear);
}

bool is_identity(const Matrix& G) {
  const Size n = G.shape(1);
  bool found = G.shape(0) == n;
  for (Size i = 0; found && i < n * n; ++i) found = G.data()[i] == (i % (n + 1) == 0 ? 1.0 : 0.0);
  return found;
}

// Rows low <= A x <= up of a programme, and the bounds on single joint rates that never give way.
//
// Each of `rows` is (G, lower, upper, give); the last two rows are s >= 0 and slack >= 0.
nb::tuple stacked_rows(const Matrix& V, const nb::sequence& rows) {
  const int n = static_cast<int>(V.shape(0)), size = n + 2;
  struct Row {
    const double* g;
    double low, up, give;
  };
  std::vector<Row> all;
  std::vector<Matrix> kept;  // keeps what rows point into
  Out hard_low = new_array(n), hard_up = new_array(n);
  std::fill_n(hard_low.data(), n, -kUnbounded);
  std::fill_n(hard_up.data(), n, kUnbounded);
  for (nb::handle one : rows) {
    const Matrix& G = kept.emplace_back(nb::cast<Matrix>(one[0]));
    const auto low = nb::cast<Vector>(one[1]), up = nb::cast<Vector>(one[2]);
    const double give = nb::cast<double>(one[3]);
    const int count = static_cast<int>(G.shape(0));
    for (int j = 0; give == 0.0 && j < n && is_identity(G); ++j) {
      hard_low.data()[j] = std::max(hard_low.data()[j], low(j));
      hard_up.data()[j] = std::min(hard_up.data()[j], up(j));
    }
    // A side that gives way is a row of its own.
    for (int r = 0; r < count; ++r) {
      const double most = give == 0.0 ? up(r) : kUnbounded;
      if (give == 0.0 || low(r) > -kUnbounded) all.push_back({G.data() + r * n, low(r), most, give});
    }
    for (int r = 0; give != 0.0 && r < count; ++r) {
      if (up(r) < kUnbounded) all.push_back({G.data() + r * n, -kUnbounded, up(r), -give});
    }
  }
  const int count = static_cast<int>(all.size());
  Out A = new_array(count + 2, size), low = zeros(count + 2), up = new_array(count + 2);
  std::fill_n(A.data(), (count + 2) * size, 0.0);
  for (int r = 0; r < count; ++r) {
    times_basis(all[r].g, V.data(), n, A.data() + r * size);
    A.data()[r * size + n + 1] = all[r].give;
    low.data()[r] = all[r].low;
    up.data()[r] = all[r].up;
  }
  for (int k = 0; k < 2; ++k) {
    A.data()[(count + k) * size + n + k] = 1.0;
    up.data()[count + k] = kUnbounded;
  }
  return nb::make_tuple(A, low, up, hard_low, hard_up);
}

// The exact solution (x, z) of the equations of the active rows; None where it is not the programme's.
nb::object refined(const Matrix& H, const Vector& g, const Matrix& A, const Vector& low, const Vector& up,
                   const Vector& z, double tolerance, double kept) {
  const int n = static_cast<int>(g.shape(0)), rows = static_cast<int>(low.shape(0));
  std::vector<int> active;
  for (int r = 0; r < rows; ++r) {
    if (std::fabs(z(r)) > tolerance) active.push_back(r);
  }
  const int k = static_cast<int>(active.size()), size = n + k;
  std::vector<double> equations(size * (size + 1), 0.0);
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
  Out x = new_array(n), multipliers = zeros(rows);
  for (int i = 0; i < n; ++i) x.data()[i] = at(i, size);
  for (int r = 0; r < rows; ++r) {
    const double reached = dot(A.data() + r * n, x.data(), n);
    // Written so that a NaN is not the solution.
    if (!(std::max(low(r) - reached, reached - up(r)) <= kept)) return nb::none();
  }
  for (int a = 0; a < k; ++a) {
    const double multiplier = at(n + a, size);
    if (!(multiplier * z(active[a]) >= 0.0)) return nb::none();
    multipliers.data()[active[a]] = multiplier;
  }
  return nb::make_tuple(x, multipliers);
}

}  // namespace

void bind_step(nb::module_& m) {
  m.def("step_state", &step_state);
  m.def("rate_bounds", &rate_bounds);
  m.def("wanted_motion", &wanted_motion);
  m.def("scheduled", &scheduled);
  m.def("reference_speed", &reference_speed);
  m.def("objective", &objective);
  m.def("stacked_rows", &stacked_rows);
  m.def("refined", &refined);
}

}  // namespace ffsms
