// Python's view of step.hpp: plain arrays in, new arrays out.
#include <nanobind/stl/optional.h>

#include <vector>

#include "arm.hpp"
#include "arrays.hpp"
#include "step.hpp"

namespace {

using namespace ffsms;

step::Schedule schedule_of(const Vector& s) { return {s(0), s(1), s(2), s(3)}; }

// What a step is written from, of a root pose (x, y, z, quaternion): see opt/step/state.py. First columns
// (6, n), reaction, J*, J_m and C_bm; then places and twists, and the end effector's attitude.
nb::tuple step_state(const Tree& tree, const Vector& root, const Vector& joints,
                     const std::optional<Vector>& momentum) {
  const int n = tree.n;
  expect(root.shape(0) == 7 && joints.shape(0) == size_t(n), "an array has a wrong shape");
  Arm<double> arm;
  evaluate(tree, joints.data(), arm);
  const double x = root(3), y = root(4), z = root(5), w = root(6);
  const Mat3<double> R = {{{1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)},
                           {2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)},
                           {2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)}}};
  auto columns = new_array(4, 6, n), more = new_array(27);
  for (int j = 0; j < n; ++j) {
    const Vec3<double> turning = tree.joints[j].moves_tip ? arm.axis[j] : zero3<double>();
    const Vec3<double> of_joint[] = {
        arm.root[j], arm.spin[j], R * arm.jstar[j], R * (arm.spin[j] + turning), R * arm.tip_velocity[j],
        R * turning};
    for (int i = 0; i < 18; ++i) columns.data()[i * n + j] = of_joint[i / 3][i % 3];
    for (int i = 0; i < 6; ++i) columns.data()[(18 + i) * n + j] = arm.coupling[i][j];
  }
  Vec3<double> spin = zero3<double>(), moving = spin;
  if (momentum) {
    const double* h = momentum->data();
    spin = arm.inverse * (transposed(R) * Vec3<double>{{h[3], h[4], h[5]}});
    moving =
        (1.0 / tree.total_mass) * (transposed(R) * Vec3<double>{{h[0], h[1], h[2]}}) + cross(arm.com, spin);
  }
  const Vec3<double> origin{{root(0), root(1), root(2)}};
  const Vec3<double> of_all[] = {
      origin + R * arm.tip, arm.com, moving, spin, R * (moving + cross(spin, arm.tip)), R * spin};
  const Mat3<double> attitude = R * arm.tip_rotation;
  for (int i = 0; i < 18; ++i) more.data()[i] = of_all[i / 3][i % 3];
  for (int i = 0; i < 9; ++i) more.data()[18 + i] = attitude[i / 3][i % 3];
  return nb::make_tuple(columns, more);
}

nb::tuple rate_bounds(const Matrix& limits, const Vector& joints, const Vector& rates, double dt) {
  const size_t n = rates.shape(0);
  auto least = new_array(n), greatest = new_array(n);
  for (size_t j = 0; j < n; ++j) {
    const step::JointLimit limit{limits(0, j), limits(1, j), limits(2, j), limits(3, j)};
    step::rate_bounds(limit, joints(j), rates(j), dt, least.data()[j], greatest.data()[j]);
  }
  return nb::make_tuple(least, greatest);
}

// (towards, direction, speed, side), or None where the end effector has arrived.
nb::object wanted_motion(const Vector& s, const Vector& way, const Matrix& J, const Vector& rates,
                         const Vector& drift, const Vector& acceleration, const Vector& side, double cosine,
                         double time_left, double dt) {
  const step::Schedule schedule = schedule_of(s);
  const int n = int(rates.shape(0));
  const double distance = std::sqrt(step::dot(way.data(), way.data()));
  if (distance < 1e-12) return nb::none();
  auto towards = new_array(3), direction = new_array(3), lateral = new_array(3);
  double velocity[3];
  for (int i = 0; i < 3; ++i) {
    towards.data()[i] = way(size_t(i)) / distance;
    velocity[i] = step::dot(J.data() + i * n, rates.data(), n) + drift(size_t(i));
  }
  const bool sided = side(0) != 0.0 || side(1) != 0.0 || side(2) != 0.0;
  step::lateral_direction(towards.data(), sided ? side.data() : velocity, lateral.data());
  step::cone_direction(towards.data(), lateral.data(), cosine, direction.data());
  std::vector<double> gradient(size_t(n), 0.0);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < n; ++j) gradient[size_t(j)] += direction.data()[i] * J.data()[i * n + j];
  // A path at a constant angle to the direction of the target is 1 / cos longer than the straight one.
  const double along = std::max(cosine, schedule.least_approach);
  double speed = step::scheduled(schedule, distance / along, step::dot(velocity, direction.data()),
                                 gradient.data(), acceleration.data(), n, time_left, dt);
  speed = std::min(speed, schedule.nearing * distance * along / dt);
  return nb::make_tuple(towards, direction, speed, lateral);
}

double scheduled(const Vector& s, double left, double speed, const Vector& gradient,
                 const Vector& acceleration, double time_left, double dt) {
  return step::scheduled(schedule_of(s), left, speed, gradient.data(), acceleration.data(),
                         int(gradient.shape(0)), time_left, dt);
}

double reference_speed(const Vector& s, double path_left, double speed, double time_left, double dt) {
  return step::reference_speed(schedule_of(s), path_left, speed, time_left, dt);
}

// H (n + 2, n + 2) and g (n + 2,) of direction, speed, effort, change and slack.
nb::tuple objective(const Matrix& J, const Matrix& V, const Vector& rates, const Vector& drift,
                    const Vector& direction, double speed, const Vector& weights, bool plain_effort) {
  const int n = int(rates.shape(0)), size = n + 2;
  auto H = new_array(size_t(size), size_t(size));
  auto g = new_array(size_t(size));
  std::vector<double> S(size_t(3 * size), 0.0);
  step::times_basis(J.data(), V.data(), 3, n, S.data(), size);
  double still[3];
  for (int i = 0; i < 3; ++i) {
    S[size_t(i * size + n)] = -direction(size_t(i));
    still[i] = -drift(size_t(i));
  }
  const double w_direction = weights(0), w_speed = weights(1), w_effort = weights(2), w_change = weights(3),
               w_slack = weights(4);
  std::fill_n(H.data(), size * size, 0.0);
  std::fill_n(g.data(), size, 0.0);
  step::add_square(S.data(), still, 3, size, w_direction, H.data(), g.data());
  // V turns without stretching, so that |u| = |alpha|: effort and change are diagonal in alpha, too.
  for (int i = 0; i < n; ++i) H.data()[i * size + i] += w_change + (plain_effort ? w_effort : 0.0);
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) g.data()[i] -= w_change * rates(size_t(j)) * V(size_t(j), size_t(i));
  H.data()[n * size + n] += w_speed;
  g.data()[n] -= w_speed * speed;
  H.data()[(n + 1) * size + n + 1] += w_slack;
  g.data()[n + 1] += w_slack;
  return nb::make_tuple(H, g);
}

// Rows low <= A x <= up of a programme, and the bounds on single joint rates that never give way.
//
// Each of `rows` is (G, lower, upper, give); the last two rows are s >= 0 and slack >= 0.
nb::tuple stacked_rows(const Matrix& V, const nb::sequence& rows) {
  const int n = int(V.shape(0)), size = n + 2;
  struct Row {
    const double* g;
    double low, up, give;
  };
  std::vector<Row> all;
  std::vector<Matrix> kept;  // keeps what rows point into
  auto hard_low = new_array(size_t(n)), hard_up = new_array(size_t(n));
  std::fill_n(hard_low.data(), n, -step::unbounded);
  std::fill_n(hard_up.data(), n, step::unbounded);
  for (nb::handle one : rows) {
    const auto G = nb::cast<Matrix>(one[0]);
    const auto low = nb::cast<Vector>(one[1]), up = nb::cast<Vector>(one[2]);
    const double give = nb::cast<double>(one[3]);
    const int count = int(G.shape(0));
    bool identity = give == 0.0 && count == n;
    for (int r = 0; identity && r < n; ++r)
      for (int c = 0; c < n; ++c) identity = identity && G.data()[r * n + c] == (r == c ? 1.0 : 0.0);
    if (identity)
      for (int j = 0; j < n; ++j) {
        hard_low.data()[j] = std::max(hard_low.data()[j], low(size_t(j)));
        hard_up.data()[j] = std::min(hard_up.data()[j], up(size_t(j)));
      }
    bool two_sided = false;
    for (int r = 0; r < count; ++r) two_sided = two_sided || up(size_t(r)) < step::unbounded;
    if (give == 0.0 || !two_sided) {
      for (int r = 0; r < count; ++r) all.push_back({G.data() + r * n, low(size_t(r)), up(size_t(r)), give});
    } else {  // a side that gives way is a row of its own
      for (int r = 0; r < count; ++r)
        if (low(size_t(r)) > -step::unbounded)
          all.push_back({G.data() + r * n, low(size_t(r)), step::unbounded, give});
      for (int r = 0; r < count; ++r)
        if (up(size_t(r)) < step::unbounded)
          all.push_back({G.data() + r * n, -step::unbounded, up(size_t(r)), -give});
    }
    kept.push_back(G);
  }
  const int count = int(all.size());
  auto A = new_array(size_t(count + 2), size_t(size));
  auto low = new_array(size_t(count + 2)), up = new_array(size_t(count + 2));
  for (int r = 0; r < count; ++r) {
    const Row& row = all[size_t(r)];
    double* out = A.data() + r * size;
    step::times_basis(row.g, V.data(), 1, n, out, size);
    out[n] = 0.0;
    out[n + 1] = row.give;
    low.data()[r] = row.low;
    up.data()[r] = row.up;
  }
  for (int k = 0; k < 2; ++k) {
    double* out = A.data() + (count + k) * size;
    std::fill_n(out, size, 0.0);
    out[n + k] = 1.0;
    low.data()[count + k] = 0.0;
    up.data()[count + k] = step::unbounded;
  }
  return nb::make_tuple(A, low, up, hard_low, hard_up);
}

// The exact solution (x, z) of the equations of the active rows; None where it is not the programme's.
nb::object refined(const Matrix& H, const Vector& g, const Matrix& A, const Vector& low, const Vector& up,
                   const Vector& z, double tolerance, double kept) {
  const int n = int(g.shape(0)), rows = int(low.shape(0));
  std::vector<int> active;
  for (int r = 0; r < rows; ++r)
    if (std::fabs(z(size_t(r))) > tolerance) active.push_back(r);
  const int k = int(active.size()), size = n + k;
  std::vector<double> matrix(size_t(size * size), 0.0), right(size_t(size), 0.0);
  for (int i = 0; i < n; ++i) {
    std::copy_n(H.data() + i * n, n, matrix.data() + i * size);
    right[size_t(i)] = -g(size_t(i));
  }
  for (int a = 0; a < k; ++a) {
    const size_t r = size_t(active[size_t(a)]);
    for (int i = 0; i < n; ++i)
      matrix[size_t((n + a) * size + i)] = matrix[size_t(i * size + n + a)] = A(r, size_t(i));
    right[size_t(n + a)] = z(r) > 0.0 ? up(r) : low(r);
  }
  if (!step::solve(matrix.data(), right.data(), size)) return nb::none();
  for (int r = 0; r < rows; ++r) {
    const double reached = step::dot(A.data() + r * n, right.data(), n);
    // Written so that a NaN is not the solution.
    if (!(std::max(low(size_t(r)) - reached, reached - up(size_t(r))) <= kept)) return nb::none();
  }
  auto x = new_array(size_t(n)), multipliers = new_array(size_t(rows));
  std::copy_n(right.data(), n, x.data());
  std::fill_n(multipliers.data(), rows, 0.0);
  for (int a = 0; a < k; ++a) {
    const size_t r = size_t(active[size_t(a)]);
    if (!(right[size_t(n + a)] * z(r) >= 0.0)) return nb::none();
    multipliers.data()[r] = right[size_t(n + a)];
  }
  return nb::make_tuple(x, multipliers);
}

}  // namespace

void ffsms::bind_step(nb::module_& m) {
  m.def("step_state", &step_state, nb::arg(), nb::arg(), nb::arg(), nb::arg().none());
  m.def("rate_bounds", &rate_bounds);
  m.def("wanted_motion", &wanted_motion);
  m.def("scheduled", &scheduled);
  m.def("reference_speed", &reference_speed);
  m.def("objective", &objective);
  m.def("stacked_rows", &stacked_rows);
  m.def("refined", &refined);
}
