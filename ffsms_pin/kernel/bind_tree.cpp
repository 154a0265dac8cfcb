// The robot, handed over once.
#include <cstring>

#include "arrays.hpp"
#include "bindings.hpp"
#include "tree.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

// Of a joint's axis, as Pinocchio's Jacobian gives it.
constexpr double kAxisRounding = 1e-14;

using Table = In;  // (n, columns)

Vec3<double> vector(const double* x) { return {{x[0], x[1], x[2]}}; }

Mat3<double> matrix(const double* x) {
  return {{{x[0], x[1], x[2]}, {x[3], x[4], x[5]}, {x[6], x[7], x[8]}}};
}

// Which axis of its own frame a joint turns about; -1: none of them. The axis is made exact.
int own_axis(Vec3<double>& axis) {
  for (int k = 0; k < 3; ++k) {
    Vec3<double> unit = zero3<double>();
    unit[k] = axis[k] > 0.0 ? 1.0 : -1.0;
    const Vec3<double> apart = axis - unit;
    if (dot(apart, apart) < kAxisRounding * kAxisRounding) {
      axis = unit;
      return k;
    }
  }
  return -1;
}

// A row of `joints`: parent, turns, moves_tip, axis (3), offset (3), placement (9). A row of `bodies`, the
// base first: mass, lever (3), inertia about the centre of mass (9).
Tree made(const Table& joints, const Table& bodies, const Table& tip, int last, bool moves,
          bool turns_freely) {
  const int n = static_cast<int>(joints.shape(0));
  expect(n >= 1 && n <= kMostJoints, "the kernel takes 1 to 64 joints");
  expect_rows(joints, n, 18);
  expect_rows(bodies, n + 1, 13);
  expect_rows(tip, 1, 12);
  expect(last >= -1 && last < n, "the end effector's joint is not there");
  Tree tree = {};
  tree.n = n;
  tree.last = last;
  tree.tip_in_last = vector(tip.data());
  tree.tip_turn = matrix(tip.data() + 3);
  const double* base = bodies.data();
  tree.total_mass = base[0];
  tree.base_com = vector(base + 1);
  tree.base_moment = base[0] * tree.base_com;
  tree.base_inertia = matrix(base + 4);
  add_steiner(tree.base_inertia, base[0], tree.base_com);
  for (int j = 0; j < n; ++j) {
    Joint& joint = tree.joints[j];
    const double *row = joints.data() + 18 * j, *body = bodies.data() + 13 * (j + 1);
    joint.parent = static_cast<int>(row[0]);
    expect(joint.parent >= -1 && joint.parent < j, "a joint comes before the one that carries it");
    joint.turns = row[1] != 0.0;
    joint.moves_tip = row[2] != 0.0;
    joint.axis = vector(row + 3);
    joint.own_axis = own_axis(joint.axis);
    joint.offset = vector(row + 6);
    joint.placement = matrix(row + 9);
    joint.mass = body[0];
    joint.lever = vector(body + 1);
    joint.inertia = matrix(body + 4);
    tree.total_mass += body[0];
    for (int i = j; i >= 0; i = tree.joints[i].parent) tree.joints[i].carried_mass += body[0];
  }
  tree.moves = moves;
  tree.turns_freely = turns_freely;
  tree.inverse_mass = moves ? 1.0 / tree.total_mass : 0.0;
  return tree;
}

}  // namespace

void bind_tree(nb::module_& m) {
  nb::class_<Tree>(m, "Tree", "The robot in plain numbers.")
      .def(
          "__init__",
          [](Tree* self, const Table& joints, const Table& bodies, const Table& tip, int last, bool moves,
             bool turns_freely) { new (self) Tree(made(joints, bodies, tip, last, moves, turns_freely)); },
          nb::arg("joints"), nb::arg("bodies"), nb::arg("tip"), nb::arg("last"), nb::arg("moves"),
          nb::arg("turns_freely"))
      .def_ro("n", &Tree::n)
      .def("__getstate__", [](const Tree& self) { return nb::bytes(&self, sizeof self); })
      .def("__setstate__", [](Tree& self, const nb::bytes& state) {
        expect(state.size() == sizeof(Tree), "a tree of another build");
        std::memcpy(static_cast<void*>(&self), state.data(), sizeof(Tree));
      });
}

}  // namespace ffsms
