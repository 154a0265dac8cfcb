// Python's view of step.hpp: plain arrays in, new arrays out.
#include <nanobind/stl/optional.h>

#include <optional>
#include <vector>

#include "arrays.hpp"
#include "entropy.hpp"
#include "step.hpp"

namespace ffsms {
namespace {

using View = nb::ndarray<const double, nb::ndim<2>, nb::device::cpu>;  // in any order
using Triple = Table<double, 3>;
using Twist = Table<double, 6>;
using Jacobian = Table<double, 6, -1>;

Out array_of(const std::vector<double>& values) {
  Out out = new_array(values.size());
  std::copy(values.begin(), values.end(), out.data());
  return out;
}

// What a step is written from, of a root pose (x, y, z, quaternion): see opt/step/state.py. First columns
// (6, n), reaction, J* and J_m; then V (n, n); then places, twists, the end effector's attitude, and
// the paper's entropy.
nb::tuple step_state(const Tree& tree, const Table<double, 7>& root, const Vector& joints,
                     const std::optional<Twist>& momentum) {
  const int n = tree.n;
  expect(joints.shape(0) == static_cast<Size>(n), "an array has a wrong shape");
  Arm<double> arm;
  evaluate(tree, joints.data(), arm);
  const double x = root(3), y = root(4), z = root(5), w = root(6);
  const Mat3<double> R = {{{1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)},
                           {2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)},
                           {2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)}}};
  Out columns = new_array(3, 6, n), basis = new_array(n, n), more = new_array(28);
  double A[kMostJoints * 6], V[kMostJoints * kMostJoints], sigma[kMostJoints];
  for (int j = 0; j < n; ++j) {
    Writer<double> write = {columns.data() + j, static_cast<Size>(n)};
    const Vec3<double> turning = tree.joints[j].moves_tip ? arm.axis[j] : Vec3<double>{};
    for (const Vec3<double>& column : {arm.root[j], arm.spin[j], R * arm.jstar[j],
                                       R * (arm.spin[j] + turning), R * arm.tip_velocity[j], R * turning}) {
      write.put(&column, 1);
    }
    for (int i = 0; i < 6; ++i) A[j * 6 + i] = arm.coupling[i * n + j];
  }
  // Singular values depend on the reference point, the base's centre of mass, and not on the axes.
  decompose(6, n, A, V, sigma);
  sort(n, sigma, V);
  Writer<double> rows = {basis.data(), 1};
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) rows.put(&V[j * n + i], 1);
  }
  Vec3<double> spin = Vec3<double>{}, moving = spin;
  if (momentum) {
    const Mat3<double> back = transposed(R);
    spin = arm.inverse * (back * of_numbers<Vec3<double>>(momentum->data() + 3));
    moving =
        (1.0 / tree.total_mass) * (back * of_numbers<Vec3<double>>(momentum->data())) + cross(arm.com, spin);
  }
  Writer<double> write = {more.data(), 1};
  for (const Vec3<double>& one : {of_numbers<Vec3<double>>(root.data()) + R * arm.tip, arm.com, moving, spin,
                                  R * (moving + cross(spin, arm.tip)), R * spin}) {
    write.put(&one, 1);
  }
  const Mat3<double> attitude = R * arm.tip_rotation;
  const double entropy = normalised_entropy(sigma, n);
  write.put(&attitude, 1);
  write.put(&entropy, 1);
  return nb::make_tuple(columns, basis, more);
}

// Least and greatest rates (2, n) at the step's end, of limits (4, n): lower, upper, velocity, acceleration.
Out rate_bounds(const Table<double, 4, -1>& limits, const Vector& joints, const Vector& rates, double dt) {
  const Size n = rates.shape(0);
  Out bounds = new_array(2, n);
  for (Size j = 0; j < n; ++j) {
    const double velocity = std::min(limits(2, j), kUnbounded), acceleration = limits(3, j);
    const double down = greatest_rate(joints(j) - limits(0, j), -rates(j), velocity, acceleration, dt);
    const double up = greatest_rate(limits(1, j) - joints(j), rates(j), velocity, acceleration, dt);
    bounds.data()[j] = -down;
    bounds.data()[n + j] = std::max(up, -down);  // where there is no room to brake, the lower one is both
  }
  return bounds;
}

// Unit vectors to the target and along the wanted motion, its side, the wanted spin, and the speed (13,): see
// `WantedMotion`. J is J* (6, n), `rotation` the wanted attitude (3, 3).
Out wanted_motion(const Triple& way, const std::optional<Rotation>& rotation, const Rotation& attitude,
                  const Jacobian& J, const Vector& rates, const Twist& drift, const Vector& acceleration,
                  const Triple& side, double cosine, double time_left, double dt) {
  const int n = static_cast<int>(rates.shape(0));
  const auto reached = [&](double left, const Vec3<double>& direction, int row) {
    return reached_speed(left, direction, J.data() + row * n, rates.data(), drift.data() + row,
                         acceleration.data(), n, time_left, dt);
  };
  Vec3<double> towards = of_numbers<Vec3<double>>(way.data()),
               lateral = of_numbers<Vec3<double>>(side.data());
  Vec3<double> direction = Vec3<double>{}, spin = direction;
  const double distance = std::sqrt(dot(towards, towards));
  double speed = 0.0;
  if (distance < 1e-12) {
    towards = direction;
  } else {
    towards = towards / distance;
    if (dot(lateral, lateral) == 0.0) {  // the side on which the end effector is moving
      for (int i = 0; i < 3; ++i) lateral[i] = dot(J.data() + i * n, rates.data(), n) + drift(i);
    }
    lateral = lateral_direction(towards, lateral);
    direction = cosine * towards + std::sqrt(std::max(0.0, 1.0 - cosine * cosine)) * lateral;
    // A path at a constant angle to the direction of the target is 1 / cos longer than the straight one. One
    // step goes half of the way to the point of a straight step that is nearest to the target at most: a
    // longer step at an angle to the target would go round it instead of nearing it.
    const double along = std::max(cosine, kLeastApproach);
    speed = std::min(reached(distance / along, direction, 0), 0.5 * distance * along / dt);
  }
  if (rotation) {
    const Vec3<double> turn = log3(of_numbers<Mat3<double>>(rotation->data()) *
                                   transposed(of_numbers<Mat3<double>>(attitude.data())));
    const double angle = std::sqrt(dot(turn, turn));
    // Nearer than that it is rounding.
    if (angle >= 1e-12) spin = reached(angle, turn / angle, 3) * (turn / angle);
  }
  Out out = new_array(13);
  Writer<double> write = {out.data(), 1};
  for (const Vec3<double>& one : {towards, direction, lateral, spin}) write.put(&one, 1);
  write.put(&speed, 1);
  return out;
}

// A (m, n + 2), low and up of a programme low <= A x <= up, from the (G, lower, upper, give) of limits. The
// last two rows are s >= 0 and slack >= 0.
nb::tuple stacked_rows(const Matrix& V, const nb::sequence& limits) {
  const Size n = V.shape(0), size = n + 2;
  std::vector<double> A, low, up;
  const auto add = [&](double least, double most) {
    low.push_back(least);
    up.push_back(most);
    A.resize(A.size() + size, 0.0);
    return &A[A.size() - size];
  };
  for (nb::handle one : limits) {
    const auto G = nb::cast<View>(one[0]);
    const auto lower = nb::cast<Vector>(one[1]), upper = nb::cast<Vector>(one[2]);
    const double give = nb::cast<double>(one[3]);
    const auto add_row = [&](Size r, double least, double most, double slack) {
      double* row = add(least, most);
      for (Size j = 0; j < n; ++j) {
        const double g = G(r, j);
        for (Size c = 0; g != 0.0 && c < n; ++c) row[c] += g * V(j, c);
      }
      row[n + 1] = slack;
    };
    // A side that gives way is a row of its own.
    for (Size r = 0; r < lower.shape(0); ++r) {
      if (give == 0.0)
        add_row(r, lower(r), upper(r), 0.0);
      else if (lower(r) > -kUnbounded)
        add_row(r, lower(r), kUnbounded, give);
    }
    for (Size r = 0; give != 0.0 && r < lower.shape(0); ++r) {
      if (upper(r) < kUnbounded) add_row(r, -kUnbounded, upper(r), -give);
    }
  }
  for (Size k : {n, n + 1}) add(0.0, kUnbounded)[k] = 1.0;
  Out rows = new_array(low.size(), size);
  std::copy(A.begin(), A.end(), rows.data());
  return nb::make_tuple(rows, array_of(low), array_of(up));
}

// The wanted motion, H (n + 2, n + 2) with g below it, of 1/2 x^T H x + g^T x, and the rows. H weighs
// direction, speed, effort, change, slack, and the end effector's spin.
nb::tuple step_programme(const Triple& way, const std::optional<Rotation>& rotation, const Rotation& attitude,
                         const Jacobian& J, const Matrix& V, const Vector& rates, const Twist& drift,
                         const Vector& acceleration, const Triple& side, double cosine, double time_left,
                         double dt, const Table<double, 6>& weights, const nb::sequence& limits) {
  const int n = static_cast<int>(rates.shape(0)), size = n + 2;
  expect(n <= kMostJoints, "the kernel takes 1 to 64 joints");
  const Out wanted =
      wanted_motion(way, rotation, attitude, J, rates, drift, acceleration, side, cosine, time_left, dt);
  const double *direction = wanted.data() + 3, *spin = wanted.data() + 9, speed = wanted.data()[12];
  Out goal = new_array(size + 1, size);
  std::fill_n(goal.data(), (size + 1) * size, 0.0);
  double *H = goal.data(), *g = H + size * size, row[kMostJoints + 1];
  // J V alpha + drift is to be along the direction, or the wanted spin.
  for (int r = 0; r < (rotation ? 6 : 3); ++r) {
    const double weight = weights(r < 3 ? 0 : 2), offset = r < 3 ? drift(r) : drift(r) - spin[r - 3];
    for (int c = 0; c < n; ++c) {
      row[c] = 0.0;
      for (int j = 0; j < n; ++j) row[c] += J(r, j) * V(j, c);
    }
    row[n] = r < 3 ? -direction[r] : 0.0;
    for (int i = 0; i <= n; ++i) {
      const double weighted = weight * row[i];
      g[i] += weighted * offset;
      for (int j = 0; j <= n; ++j) H[i * size + j] += weighted * row[j];
    }
  }
  // V turns without stretching, so that |u| = |alpha|: effort and change are diagonal in alpha, too.
  for (int i = 0; i < n; ++i) {
    H[i * size + i] += weights(4) + weights(3);
    for (int j = 0; j < n; ++j) g[i] -= weights(4) * rates(j) * V(j, i);
  }
  H[n * size + n] += weights(1);
  g[n] -= weights(1) * speed;
  H[(n + 1) * size + n + 1] += weights(5);
  g[n + 1] += weights(5);
  return nb::make_tuple(wanted, goal, stacked_rows(V, limits));
}

// The exact solution (x, z) of the equations of the active rows; None where it is not the programme's.
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
    // Written so that a NaN is not the solution.
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
  m.def("step_programme", &step_programme);
  m.def("refined", &refined);
}

}  // namespace ffsms
