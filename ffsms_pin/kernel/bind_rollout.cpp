// Base attitudes along a motion.
#include "arrays.hpp"
#include "bindings.hpp"
#include "rollout.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

Vec3<double> column(const In& array, Size k) {
  Vec3<double> out;
  Reader(array, k).next(out.v, 3);
  return out;
}

Mat3<double> matrix(const In& array) {
  expect_rows(array, 3, 3);
  Mat3<double> out;
  std::memcpy(out.m, array.data(), sizeof out.m);
  return out;
}

void put(const Mat3<double>& R, const Out& attitudes, Size k) { Writer(attitudes, k).put(&R, 1); }

// Attitudes (9, 2 N + 1) at the nodes and in the middles of N steps, of angular velocities (3, 2 N + 1)
// there.
void attitudes(const In& start, const In& omega, double dt, const Out& out) {
  const Size count = omega.shape(1);
  expect_rows(omega, 3, count);
  expect_rows(out, 9, count);
  Mat3<double> R = matrix(start);
  put(R, out, 0);
  for (Size k = 0; k + 2 < count; k += 2) {
    const Vec3<double> first = column(omega, k), middle = column(omega, k + 1), last = column(omega, k + 2);
    put(R * turned_by_half(first, middle, last, dt), out, k + 1);
    R = R * turned_by(first, middle, last, dt);
    put(R, out, k + 2);
  }
}

// The same of a system with angular momentum (3, 1): attitudes (9, N + 1) after N steps, of joint positions
// and rates (n, 2 N + 1) at their nodes and middles.
void tumbling(const Tree& tree, const In& start, const In& positions, const In& rates, const In& momentum,
              double dt, const Out& out) {
  const Size count = positions.shape(1);
  expect_rows(positions, tree.n, count);
  expect_rows(rates, tree.n, count);
  expect_rows(momentum, 3, 1);
  expect_rows(out, 9, count / 2 + 1);
  Arm<double> arm;
  double q[kMostJoints] = {}, u[kMostJoints] = {};
  const auto spin = [&](Size k) {
    Reader(positions, k).next(q, tree.n);
    Reader(rates, k).next(u, tree.n);
    return spin_at(tree, q, u, arm);
  };
  const Vec3<double> h = column(momentum, 0);
  Mat3<double> R = matrix(start);
  put(R, out, 0);
  Spin first = spin(0);
  for (Size k = 0; k + 2 < count; k += 2) {
    const Spin middle = spin(k + 1), last = spin(k + 2);
    R = tumbled(R, first, middle, last, h, dt);
    put(R, out, k / 2 + 1);
    first = last;
  }
}

}  // namespace

void bind_rollout(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  m.def("attitudes", &attitudes, nb::arg("start"), nb::arg("omega"), nb::arg("dt"),
        nb::arg("out").noconvert(), quiet);
  m.def("tumbling_attitudes", &tumbling, nb::arg("tree"), nb::arg("start"), nb::arg("positions"),
        nb::arg("rates"), nb::arg("momentum"), nb::arg("dt"), nb::arg("out").noconvert(), quiet);
}

}  // namespace ffsms
