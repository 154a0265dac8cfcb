// The arm at stacks of configurations.
#include "arm.hpp"
#include "arrays.hpp"
#include "bindings.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

template <class T>
struct Work {
  T positions[kMostJoints];
  Arm<T> arm;
  Vec3<T> turning[kMostJoints];
  T H[kMostJoints][kMostJoints];
};

// Calls use(work, writer) at one configuration, or pack of them, after the other: the positions are there.
template <class Use>
void at_each(const Tree& tree, const In& positions, const Out& out, int rows, const Use& use) {
  const Size count = positions.shape(1);
  expect_rows(positions, tree.n, count);
  expect_rows(out, rows, count);
  along<Work>(count, [&](auto& work, Size k) {
    Reader(positions, k).next(work.positions, tree.n);
    Writer write(out, k);
    use(work, write);
  });
}

// Twists of the joints as far as they move the end effector: angular.
template <class T>
void turn_tip(const Tree& tree, Work<T>& work) {
  for (int j = 0; j < tree.n; ++j) work.turning[j] = tree.joints[j].moves_tip ? work.arm.axis[j] : zero3<T>();
}

// What `ArmValues` holds beside the positions, in its order: 54 n + 27 rows.
void arm_values(const Tree& tree, const In& positions, const Out& out) {
  const int n = tree.n;
  at_each(tree, positions, out, 54 * n + 27, [&](auto& work, Writer& write) {
    auto& arm = work.arm;
    evaluate(tree, work.positions, arm);
    write.put(arm.axis, n);
    write.put(arm.velocity, n);
    write.put(arm.linear, n);
    write.put(arm.angular, n);
    write.put(arm.moment, n);
    write.put(arm.inertia, n);
    write.put(&arm.com, 1);
    write.put(&arm.inverse, 1);
    write.put(arm.spin, n);
    write.put(arm.root, n);
    write.put(&arm.tip, 1);
    write.put(&arm.tip_rotation, 1);
    write.put(arm.tip_velocity, n);
    write.put(arm.jstar, n);
    for (int x = 0; x < 6; ++x) write.put(arm.coupling[x], n);
    for (int x = 0; x < 3; ++x) {
      for (int j = 0; j < n; ++j) write.put(&arm.origin[j][x], 1);
      write.put(&arm.tip[x], 1);
    }
    write.put(arm.rotation, n);
  });
}

// Rotations, origins and twists: 18 n rows.
void poses(const Tree& tree, const In& positions, const Out& out) {
  at_each(tree, positions, out, 18 * tree.n, [&](auto& work, Writer& write) {
    auto& arm = work.arm;
    pose(tree, work.positions, arm);
    write.put(arm.rotation, tree.n);
    write.put(arm.origin, tree.n);
    write.put(arm.axis, tree.n);
    write.put(arm.velocity, tree.n);
  });
}

// C_bm and J* (6, n), the end effector from the base's centre of mass: 12 n + 3 rows.
void coupled(const Tree& tree, const In& positions, const Out& out) {
  const int n = tree.n;
  at_each(tree, positions, out, 12 * n + 3, [&](auto& work, Writer& write) {
    auto& arm = work.arm;
    evaluate(tree, work.positions, arm);
    for (int x = 0; x < 6; ++x) write.put(arm.coupling[x], n);
    write.put(arm.jstar, n);
    turn_tip(tree, work);
    for (int j = 0; j < n; ++j) work.turning[j] += arm.spin[j];
    write.put(work.turning, n);
    for (int x = 0; x < 3; ++x) arm.tip[x] = arm.tip[x] - tree.base_com[x];
    write.put(&arm.tip, 1);
  });
}

// J_m (6, n), on a fixed base: 6 n rows.
void fixed_base(const Tree& tree, const In& positions, const Out& out) {
  at_each(tree, positions, out, 6 * tree.n, [&](auto& work, Writer& write) {
    auto& arm = work.arm;
    evaluate(tree, work.positions, arm);
    write.put(arm.tip_velocity, tree.n);
    turn_tip(tree, work);
    write.put(work.turning, tree.n);
  });
}

// H_q: n n rows.
void inertias(const Tree& tree, const In& positions, const Out& out) {
  at_each(tree, positions, out, tree.n * tree.n, [&](auto& work, Writer& write) {
    auto& arm = work.arm;
    evaluate(tree, work.positions, arm);
    reduced_inertia(tree, arm, work.H);
    for (int i = 0; i < tree.n; ++i) write.put(work.H[i], tree.n);
  });
}

}  // namespace

void bind_arm(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  m.def("arm_values", &arm_values, nb::arg("tree"), nb::arg("positions"), nb::arg("out").noconvert(), quiet);
  m.def("poses", &poses, nb::arg("tree"), nb::arg("positions"), nb::arg("out").noconvert(), quiet);
  m.def("coupled", &coupled, nb::arg("tree"), nb::arg("positions"), nb::arg("out").noconvert(), quiet);
  m.def("manipulator_jacobian", &fixed_base, nb::arg("tree"), nb::arg("positions"),
        nb::arg("out").noconvert(), quiet);
  m.def("reduced_inertia", &inertias, nb::arg("tree"), nb::arg("positions"), nb::arg("out").noconvert(),
        quiet);
}

}  // namespace ffsms
