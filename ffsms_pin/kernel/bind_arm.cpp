// The arm at stacks of configurations.
#include "arm.hpp"
#include "arrays.hpp"
#include "bindings.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

// The arm at one pack of configurations after the other; `pose` or all of it.
template <class Use>
void along(const Tree& tree, const In& positions, const Use& use) {
  expect_rows(positions, tree.n, positions.shape(1));
  Arm<Pack> arm;
  Pack q[kMostJoints];
  for (Size k = 0; k < positions.shape(1); k += kLanes) {
    Reader in(positions, k);
    for (int j = 0; j < tree.n; ++j) q[j] = in.next();
    use(k, q, arm);
  }
}

// What `ArmValues` holds beside the positions, in its order: 54 n + 27 rows.
void arm_values(const Tree& tree, const In& positions, const Out& out) {
  const int n = tree.n;
  expect_rows(out, 54 * n + 27, positions.shape(1));
  along(tree, positions, [&](Size k, const Pack* q, Arm<Pack>& arm) {
    evaluate(tree, q, arm);
    Writer write(out, k);
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
    for (int x = 0; x < 6; ++x) {
      for (int j = 0; j < n; ++j) write.put(arm.coupling[x][j]);
    }
    for (int x = 0; x < 3; ++x) {
      for (int j = 0; j < n; ++j) write.put(arm.origin[j][x]);
      write.put(arm.tip[x]);
    }
    write.put(arm.rotation, n);
  });
}

// Rotations, origins and twists: 18 n rows.
void poses(const Tree& tree, const In& positions, const Out& out) {
  expect_rows(out, 18 * tree.n, positions.shape(1));
  along(tree, positions, [&](Size k, const Pack* q, Arm<Pack>& arm) {
    pose(tree, q, arm);
    Writer write(out, k);
    write.put(arm.rotation, tree.n);
    write.put(arm.origin, tree.n);
    write.put(arm.axis, tree.n);
    write.put(arm.velocity, tree.n);
  });
}

// C_bm and J* (6, n), the end effector from the base's centre of mass: 12 n + 3 rows.
void coupled(const Tree& tree, const In& positions, const Out& out) {
  const int n = tree.n;
  expect_rows(out, 12 * n + 3, positions.shape(1));
  along(tree, positions, [&](Size k, const Pack* q, Arm<Pack>& arm) {
    evaluate(tree, q, arm);
    Writer write(out, k);
    for (int x = 0; x < 6; ++x) {
      for (int j = 0; j < n; ++j) write.put(arm.coupling[x][j]);
    }
    write.put(arm.jstar, n);
    for (int x = 0; x < 3; ++x) {
      for (int j = 0; j < n; ++j) {
        write.put(tree.joints[j].moves_tip ? arm.spin[j][x] + arm.axis[j][x] : arm.spin[j][x]);
      }
    }
    const Vec3<Pack> tip = arm.tip - same<Pack>(tree.base_com);
    write.put(&tip, 1);
  });
}

// H_q: n n rows.
void inertias(const Tree& tree, const In& positions, const Out& out) {
  expect_rows(out, tree.n * tree.n, positions.shape(1));
  Pack H[kMostJoints][kMostJoints];
  along(tree, positions, [&](Size k, const Pack* q, Arm<Pack>& arm) {
    evaluate(tree, q, arm);
    reduced_inertia(tree, arm, H);
    Writer write(out, k);
    for (int i = 0; i < tree.n; ++i) {
      for (int j = 0; j < tree.n; ++j) write.put(H[i][j]);
    }
  });
}

}  // namespace

void bind_arm(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  m.def("arm_values", &arm_values, nb::arg("tree"), nb::arg("positions"), nb::arg("out"), quiet);
  m.def("poses", &poses, nb::arg("tree"), nb::arg("positions"), nb::arg("out"), quiet);
  m.def("coupled", &coupled, nb::arg("tree"), nb::arg("positions"), nb::arg("out"), quiet);
  m.def("reduced_inertia", &inertias, nb::arg("tree"), nb::arg("positions"), nb::arg("out"), quiet);
}

}  // namespace ffsms
