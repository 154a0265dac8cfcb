// Roll-outs: base attitudes along a motion, and whole systems under joint accelerations.
#include "arrays.hpp"
#include "bindings.hpp"
#include "rollout.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

// Joint positions and rates dt later, under constant accelerations.
void accelerate(int n, const double* accelerations, double dt, double* positions, double* rates) {
  for (int j = 0; j < n; ++j) {
    positions[j] += dt * (rates[j] + 0.5 * dt * accelerations[j]);
    rates[j] += dt * accelerations[j];
  }
}

// Attitudes (9, 2 N + 1) at the nodes and in the middles of N steps, of angular velocities (3, 2 N + 1) in
// base axes there: Simpson's rule and one bracket, and over a first half the parabola through the same
// points. The first column is where it starts.
void attitudes(const In& omega, double dt, const Out& out) {
  const Size count = omega.shape(1);
  expect_rows(omega, 3, count);
  expect_rows(out, 9, count);
  Mat3<double> R, middle;
  Reader start(In(out), 0);
  for (int i = 0; i < 3; ++i) start.next(R[i], 3);
  for (Size k = 0; k + 2 < count; k += 2) {
    Vec3<double> w[3];
    for (Size i = 0; i < 3; ++i) Reader(omega, k + i).next(w[i].v, 3);
    middle = R * exp3((dt / 24.0) * (5.0 * w[0] + 8.0 * w[1] - w[2]) + (dt * dt / 48.0) * cross(w[0], w[1]));
    R = R * exp3((dt / 6.0) * (w[0] + 4.0 * w[1] + w[2]) + (dt * dt / 12.0) * cross(w[0], w[2]));
    Writer(out, k + 1).put(&middle, 1);
    Writer(out, k + 2).put(&R, 1);
  }
}

// A system under joint accelerations (n, N), each held for dt, with momentum (6, 1) in inertial axes, the
// angular part about its centre of mass. States (12 + 2 n, N + 1) at the nodes: attitude and place of the
// root, joint positions and rates; the first column is where it starts.
void roll_out(const Tree& tree, const In& accelerations, const In& momentum, double dt, const Out& states) {
  const int n = tree.n;
  const Size steps = accelerations.shape(1);
  expect_rows(accelerations, n, steps);
  expect_rows(momentum, 6, 1);
  expect_rows(states, 12 + 2 * n, steps + 1);
  Mat3<double> R;
  Vec3<double> place, linear, angular;
  double q[kMostJoints] = {}, u[kMostJoints] = {}, a[kMostJoints] = {};
  Reader start(In(states), 0), total(momentum, 0);
  for (int i = 0; i < 3; ++i) start.next(R[i], 3);
  start.next(place.v, 3);
  start.next(q, n);
  start.next(u, n);
  total.next(linear.v, 3);
  total.next(angular.v, 3);

  Arm<double> arm;
  Spin first = spin_at(tree, q, u, arm);
  Vec3<double> com = place + R * arm.com;
  for (Size k = 0; k < steps; ++k) {
    Reader(accelerations, k).next(a, n);
    accelerate(n, a, 0.5 * dt, q, u);
    const Spin middle = spin_at(tree, q, u, arm);
    accelerate(n, a, 0.5 * dt, q, u);
    const Spin last = spin_at(tree, q, u, arm);
    R = tumbled(R, first, middle, last, angular, dt);
    com += dt * tree.inverse_mass * linear;
    place = com - R * arm.com;
    Writer out(states, k + 1);
    out.put(&R, 1);
    out.put(&place, 1);
    out.put(q, n);
    out.put(u, n);
    first = last;
  }
}

}  // namespace

void bind_rollout(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  m.def("attitudes", &attitudes, nb::arg("omega"), nb::arg("dt"), nb::arg("out").noconvert(), quiet);
  m.def("roll_out", &roll_out, nb::arg("tree"), nb::arg("accelerations"), nb::arg("momentum"), nb::arg("dt"),
        nb::arg("states").noconvert(), quiet);
}

}  // namespace ffsms
