// Torques of the joints at stacks of configurations.
#include "arrays.hpp"
#include "bindings.hpp"
#include "torques.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

void torques(const Tree& tree, const In& positions, const In& rates, const In& accelerations,
             const In& own_spin, const Out& out) {
  const Size count = positions.shape(1);
  for (const In* given : {&positions, &rates, &accelerations}) expect_rows(*given, tree.n, count);
  expect_rows(own_spin, 3, count);
  expect_rows(out, tree.n, count);
  Arm<Pack> arm;
  Pack q[kMostJoints], u[kMostJoints], a[kMostJoints], found[kMostJoints];
  for (Size k = 0; k < count; k += kLanes) {
    Reader place(positions, k), rate(rates, k), acceleration(accelerations, k), turn(own_spin, k);
    for (int j = 0; j < tree.n; ++j) {
      q[j] = place.next();
      u[j] = rate.next();
      a[j] = acceleration.next();
    }
    Vec3<Pack> own;
    for (int x = 0; x < 3; ++x) own[x] = turn.next();
    evaluate(tree, q, arm);
    joint_torques(tree, arm, u, a, own, found);
    Writer write(out, k);
    for (int j = 0; j < tree.n; ++j) write.put(found[j]);
  }
}

}  // namespace

void bind_torques(nb::module_& m) {
  m.def("joint_torques", &torques, nb::arg("tree"), nb::arg("positions"), nb::arg("rates"),
        nb::arg("accelerations"), nb::arg("own_spin"), nb::arg("out"),
        nb::call_guard<nb::gil_scoped_release>());
}

}  // namespace ffsms
