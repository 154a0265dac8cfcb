// Slopes by the joint positions at stacks of configurations. The arm is evaluated anew: that is quicker than
// to read what it was.
#include "arrays.hpp"
#include "bindings.hpp"
#include "slopes.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

// Calls use(arm, given, writer) for one pack after the other; `given` (rows, joints) are rates, or slopes.
template <int kRows, class Use>
void along(const Tree& tree, const In& positions, const In& given, const Out& out, int rows, const Use& use) {
  const Size count = positions.shape(1);
  expect_rows(positions, tree.n, count);
  expect_rows(given, kRows * tree.n, count);
  expect_rows(out, rows * tree.n, count);
  Arm<Pack> arm;
  Pack q[kMostJoints], values[kRows][kMostJoints];
  for (Size k = 0; k < count; k += kLanes) {
    Reader read(positions, k), more(given, k);
    for (int j = 0; j < tree.n; ++j) q[j] = read.next();
    for (int x = 0; x < kRows; ++x) {
      for (int j = 0; j < tree.n; ++j) values[x][j] = more.next();
    }
    evaluate(tree, q, arm);
    Writer write(out, k);
    use(arm, values, write);
  }
}

using Columns = Vec3<Pack>[kMostJoints];
using Rates = Pack (&)[1][kMostJoints];

// Of the base's angular velocity and of the end effector's velocity.
void velocities(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  Columns spin, tip;
  along<1>(tree, positions, rates, out, 6, [&](const Arm<Pack>& arm, Rates u, Writer& write) {
    velocity_slopes(tree, arm, u[0], spin, tip);
    write.put(spin, tree.n);
    write.put(tip, tree.n);
  });
}

void turnings(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  Columns slopes;
  along<1>(tree, positions, rates, out, 3, [&](const Arm<Pack>& arm, Rates u, Writer& write) {
    turning_slopes(tree, arm, u[0], slopes);
    write.put(slopes, tree.n);
  });
}

void momenta(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  Columns slopes;
  along<1>(tree, positions, rates, out, 3, [&](const Arm<Pack>& arm, Rates u, Writer& write) {
    momentum_slopes(tree, arm, u[0], slopes);
    write.put(slopes, tree.n);
  });
}

void fixed_base(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  Columns linear, angular;
  along<1>(tree, positions, rates, out, 6, [&](const Arm<Pack>& arm, Rates u, Writer& write) {
    fixed_base_slopes(tree, arm, u[0], linear, angular);
    write.put(linear, tree.n);
    write.put(angular, tree.n);
  });
}

void couplings(const Tree& tree, const In& positions, const In& by_coupling, const Out& out) {
  Pack gradient[kMostJoints];
  along<6>(tree, positions, by_coupling, out, 1,
           [&](const Arm<Pack>& arm, Pack(&by)[6][kMostJoints], Writer& write) {
             coupling_slopes(tree, arm, by, gradient);
             for (int j = 0; j < tree.n; ++j) write.put(gradient[j]);
           });
}

}  // namespace

void bind_slopes(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  const auto bind = [&](const char* name, auto function, const char* given) {
    m.def(name, function, nb::arg("tree"), nb::arg("positions"), nb::arg(given), nb::arg("out"), quiet);
  };
  bind("velocity_slopes", &velocities, "rates");
  bind("turning_slopes", &turnings, "rates");
  bind("momentum_slopes", &momenta, "rates");
  bind("fixed_base_slopes", &fixed_base, "rates");
  bind("coupling_slopes", &couplings, "by_coupling");
}

}  // namespace ffsms
