// Torques of the joints at stacks of configurations; the arm is evaluated anew.
#include "arrays.hpp"
#include "bindings.hpp"
#include "torques.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

template <class T>
struct Work {
  T positions[kMostJoints], rates[kMostJoints], accelerations[kMostJoints], torques[kMostJoints];
  Vec3<T> own_spin;
  Arm<T> arm;
};

void torques(const Tree& tree, const In& positions, const In& rates, const In& accelerations,
             const In& own_spin, const Out& out) {
  const Size count = positions.shape(1);
  for (const In* given : {&positions, &rates, &accelerations}) expect_rows(*given, tree.n, count);
  expect_rows(own_spin, 3, count);
  expect_rows(out, tree.n, count);
  along<Work>(count, [&](auto& work, Size k) {
    Reader(positions, k).next(work.positions, tree.n);
    Reader(rates, k).next(work.rates, tree.n);
    Reader(accelerations, k).next(work.accelerations, tree.n);
    Reader(own_spin, k).next(work.own_spin.v, 3);
    evaluate(tree, work.positions, work.arm);
    joint_torques(tree, work.arm, work.rates, work.accelerations, work.own_spin, work.torques);
    Writer(out, k).put(work.torques, tree.n);
  });
}

}  // namespace

void bind_torques(nb::module_& m) {
  m.def("joint_torques", &torques, nb::arg("tree"), nb::arg("positions"), nb::arg("rates"),
        nb::arg("accelerations"), nb::arg("own_spin"), nb::arg("out"),
        nb::call_guard<nb::gil_scoped_release>());
}

}  // namespace ffsms
