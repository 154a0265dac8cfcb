// Slopes by the joint positions at stacks of configurations. The arm is evaluated anew: that is quicker than
// to read what it was.
#include "arrays.hpp"
#include "bindings.hpp"
#include "slopes.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

template <class T>
struct Work {
  T positions[kMostJoints], given[6][kMostJoints], gradient[kMostJoints];
  Arm<T> arm;
  Vec3<T> first[kMostJoints], second[kMostJoints];
};

// Calls use(work, writer) at one configuration, or pack of them, after the other: the arm is there, and what
// is given, `each` numbers a joint.
template <class Use>
void at_each(const Tree& tree, const In& positions, const In& given, int each, const Out& out, int rows,
             const Use& use) {
  const Size count = positions.shape(1);
  expect_rows(positions, tree.n, count);
  expect_rows(given, each * tree.n, count);
  expect_rows(out, rows * tree.n, count);
  along<Work>(count, [&](auto& work, Size k) {
    Reader(positions, k).next(work.positions, tree.n);
    Reader more(given, k);
    for (int x = 0; x < each; ++x) more.next(work.given[x], tree.n);
    evaluate(tree, work.positions, work.arm);
    Writer write(out, k);
    use(work, write);
  });
}

// Of the base's angular velocity and of the end effector's velocity.
void velocities(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  at_each(tree, positions, rates, 1, out, 6, [&](auto& work, Writer& write) {
    velocity_slopes(tree, work.arm, work.given[0], work.first, work.second);
    write.put(work.first, tree.n);
    write.put(work.second, tree.n);
  });
}

void turnings(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  at_each(tree, positions, rates, 1, out, 3, [&](auto& work, Writer& write) {
    turning_slopes(tree, work.arm, work.given[0], work.first);
    write.put(work.first, tree.n);
  });
}

void momenta(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  at_each(tree, positions, rates, 1, out, 3, [&](auto& work, Writer& write) {
    momentum_slopes(tree, work.arm, work.given[0], work.first);
    write.put(work.first, tree.n);
  });
}

void fixed_base(const Tree& tree, const In& positions, const In& rates, const Out& out) {
  at_each(tree, positions, rates, 1, out, 6, [&](auto& work, Writer& write) {
    fixed_base_slopes(tree, work.arm, work.given[0], work.first, work.second);
    write.put(work.first, tree.n);
    write.put(work.second, tree.n);
  });
}

void couplings(const Tree& tree, const In& positions, const In& by_coupling, const Out& out) {
  at_each(tree, positions, by_coupling, 6, out, 1, [&](auto& work, Writer& write) {
    coupling_slopes(tree, work.arm, work.given, work.gradient);
    write.put(work.gradient, tree.n);
  });
}

}  // namespace

void bind_slopes(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  const auto bind = [&](const char* name, auto function, const char* given) {
    m.def(name, function, nb::arg("tree"), nb::arg("positions"), nb::arg(given), nb::arg("out").noconvert(),
          quiet);
  };
  bind("velocity_slopes", &velocities, "rates");
  bind("turning_slopes", &turnings, "rates");
  bind("momentum_slopes", &momenta, "rates");
  bind("fixed_base_slopes", &fixed_base, "rates");
  bind("coupling_slopes", &couplings, "by_coupling");
}

}  // namespace ffsms
