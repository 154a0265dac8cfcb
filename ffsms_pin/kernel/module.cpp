// The Python module: the class Tree, and functions that map arrays (rows, ...) of many configurations to new
// arrays (rows, B). The bindings check shapes; the headers compute.
#include <nanobind/stl/optional.h>

#include "arrays.hpp"
#include "entropy.hpp"
#include "slopes.hpp"
#include "step.hpp"

namespace ffsms {
namespace {

constexpr double kTiny = 1e-300;  // smallest divisor

// Constructs a tree; for the arguments see `Tree` in _kernel.pyi.
void make(Tree* self, const Table<double, -1, 17>& joints, const Table<double, -1, 13>& bodies,
          const Placed& tip, int last, bool moves, bool turns_freely) {
  const int n = static_cast<int>(joints.shape(0));
  expect(n >= 1 && n <= kMostJoints, "the kernel takes 1 to 64 joints");
  expect(bodies.shape(0) == joints.shape(0) + 1, "an array has a wrong shape");
  expect(last >= -1 && last < n, "the end effector's joint does not exist");
  Tree& tree = *new (self) Tree{};
  tree.n = n;
  tree.last = last;
  tree.tip = tip;
  tree.moves = moves;
  tree.turns_freely = turns_freely;
  for (int j = 0; j < n; ++j) {
    Joint& joint = tree.joints[j];
    const double* row = joints.data() + 17 * j;
    joint.parent = static_cast<int>(row[0]);
    expect(joint.parent >= -1 && joint.parent < j, "a joint comes before its parent");
    joint.turns = row[1] != 0.0;
    joint.axis = of_numbers<Vec3<double>>(row + 2);
    joint.place = of_numbers<Placed>(row + 5);
    joint.body = of_numbers<Body>(bodies.data() + 13 * (j + 1));
  }
  complete(tree, of_numbers<Body>(bodies.data()));
}

// An argument (rows, ...) at all configurations.
struct Argument {
  const In& array;
  int rows;
};

// The memory for one configuration, or for a pack of configurations: the arguments, and the results.
template <class T>
struct Work {
  T arguments[4][kMostRows * kMostJoints];
  Arm<T> arm;
  Vec3<T> columns[2][kMostJoints];
  T numbers[kMostJoints + 6], matrix[kMostJoints * kMostJoints];
};

// Returns rows (rows, B) that `use(work, write)` writes for each configuration, or for packs of them.
template <class Use>
Out stack(std::initializer_list<Argument> arguments, int rows, const Use& use) {
  const Size count = arguments.begin()->array.size() / static_cast<Size>(arguments.begin()->rows);
  for (const Argument& argument : arguments)
    expect_size(argument.array, static_cast<Size>(argument.rows) * count);
  Out out = new_array(rows, count);
  const nb::gil_scoped_release released;
  Size k = 0;
  const auto run = [&](auto number, Size lanes) {
    using T = decltype(number);
    Work<T> work;
    for (; k + lanes <= count; k += lanes) {
      T* destination = work.arguments[0];
      for (const Argument& argument : arguments) {
        Reader<T>{argument.array.data() + k, count}.next(destination, argument.rows);
        destination += kMostRows * kMostJoints;
      }
      Writer<T> write = {out.data() + k, count};
      use(work, write);
    }
  };
  if (count >= kLanes) run(Pack{}, kLanes);
  run(0.0, 1);
  return out;
}

// Returns rows as above, with the arm evaluated at the joint positions, which are the first argument.
template <class Use>
Out at_each(const Tree& tree, std::initializer_list<Argument> arguments, int rows, const Use& use) {
  const In& positions = arguments.begin()->array;
  expect(positions.ndim() > 0 && positions.shape(0) == static_cast<Size>(tree.n),
         "an array has a wrong shape");
  return stack(arguments, rows, [&](auto& work, auto& write) {
    evaluate(tree, work.arguments[0], work.arm);
    use(work, write);
  });
}

// Returns the numbers of rows and columns of matrices (rows, n, ...).
std::pair<int, int> sizes(const In& matrices) {
  expect(matrices.ndim() >= 2, "matrices have two axes");
  const Size rows = matrices.shape(0), n = matrices.shape(1);
  expect(rows >= 1 && rows <= kMostRows && n >= 1 && n <= kMostJoints, "too many rows or joints");
  return {static_cast<int>(rows), static_cast<int>(n)};
}

}  // namespace
}  // namespace ffsms

NB_MODULE(_kernel, m) {
  using namespace ffsms;
  nb::set_leak_warnings(false);  // objects in Python's caches at the exit of the interpreter are not leaks
  m.doc() = "The compiled kernel; import it from ffsms_pin.kernel.";
  nb::class_<Tree>(m, "Tree", "The robot: a base, and a tree of joints with a body on each joint.")
      .def("__init__", &make)
      .def_ro("n", &Tree::n)
      .def("__getstate__", [](const Tree& self) { return nb::bytes(&self, sizeof self); })
      .def("__setstate__", [](Tree& self, const nb::bytes& state) {
        expect(state.size() == sizeof(Tree), "the tree was pickled by another build of the kernel");
        std::memcpy(static_cast<void*>(&self), state.data(), sizeof(Tree));
      });

  // The fields of `ArmValues` after the positions, in its order.
  m.def("arm_values", [](const Tree& tree, const In& positions) {
    const int n = tree.n;
    return at_each(tree, {{positions, n}}, 42 * n + 27, [n](auto& work, auto& write) {
      const auto& arm = work.arm;
      for (const auto* columns :
           {arm.axis, arm.velocity, arm.linear, arm.angular, arm.spin, arm.root, arm.tip_velocity, arm.jstar})
        write.put(columns, n);
      for (const auto* vector : {&arm.com, &arm.tip}) write.put(vector);
      for (const auto* matrix : {&arm.inverse, &arm.tip_rotation}) write.put(matrix);
      write.put(arm.coupling, 6 * n);
      write.put(arm.origin, n + 1);
      write.put(arm.rotation, n);
    });
  });
  // C_bm and J* (6, n), and the end effector's position (3) relative to the base's centre of mass.
  m.def("coupled", [](const Tree& tree, const In& positions) {
    const int n = tree.n;
    return at_each(tree, {{positions, n}}, 12 * n + 3, [&](auto& work, auto& write) {
      const auto tip = work.arm.tip - decltype(work.arm.tip)(tree.base_com);
      write.put(work.arm.coupling, 6 * n);
      for (const auto* columns : {work.arm.jstar, work.arm.jstar_spin}) write.put(columns, n);
      write.put(&tip);
    });
  });
  // H_q (n, n).
  m.def("reduced_inertia", [](const Tree& tree, const In& positions) {
    const int n = tree.n;
    return at_each(tree, {{positions, n}}, n * n, [&](auto& work, auto& write) {
      reduced_inertia(tree, work.arm, work.matrix);
      write.put(work.matrix, n * n);
    });
  });
  // Gradients (3, n) by the joint positions of the base's angular velocity, and of the end effector's
  // velocity relative to the centre of mass; `own` is the base's angular velocity due to the momentum, None
  // for zero.
  m.def(
      "velocity_slopes",
      [](const Tree& tree, const In& positions, const In& rates, const std::optional<In>& own) {
        const int n = tree.n;
        const auto use = [&](auto& work, auto& write) {
          std::decay_t<decltype(work.columns[0][0])> spin = {};
          if (own) std::copy_n(work.arguments[2], 3, spin.v);
          velocity_slopes(tree, work.arm, work.arguments[1], spin, work.columns[0], work.columns[1]);
          for (const auto* slopes : work.columns) write.put(slopes, n);
        };
        if (!own) return at_each(tree, {{positions, n}, {rates, n}}, 6 * n, use);
        return at_each(tree, {{positions, n}, {rates, n}, {*own, 3}}, 6 * n, use);
      },
      nb::arg(), nb::arg(), nb::arg(), nb::arg() = nb::none());
  // Gradient (3, n) of the angular momentum by the joint positions if the base's attitude is held.
  m.def("momentum_slopes", [](const Tree& tree, const In& positions, const In& rates) {
    const int n = tree.n;
    return at_each(tree, {{positions, n}, {rates, n}}, 3 * n, [&](auto& work, auto& write) {
      momentum_slopes(tree, work.arm, work.arguments[1], work.columns[0]);
      write.put(work.columns[0], n);
    });
  });
  // Gradient (n) by the joint positions of a function of C_bm, from its derivative (6, n) by C_bm.
  m.def("coupling_slopes", [](const Tree& tree, const In& positions, const In& by_coupling) {
    const int n = tree.n;
    return at_each(tree, {{positions, n}, {by_coupling, 6 * n}}, n, [&](auto& work, auto& write) {
      coupling_slopes(tree, work.arm, work.arguments[1], work.numbers);
      write.put(work.numbers, n);
    });
  });
  // Joint torques (n), and the force and moment (6) that hold the base; `own` is the part of the base's
  // angular velocity due to the momentum.
  m.def("dynamics",
        [](const Tree& tree, const In& joints, const In& rates, const In& accelerations, const In& own) {
          const int n = tree.n;
          const auto arguments = {Argument{joints, n}, {rates, n}, {accelerations, n}, {own, 3}};
          return at_each(tree, arguments, n + 6, [&](auto& work, auto& write) {
            const auto* spin = work.arguments[3];
            auto *force = work.columns[0], *moment = work.columns[1];
            dynamics(tree, work.arm, work.arguments[1], work.arguments[2], {{spin[0], spin[1], spin[2]}},
                     work.numbers, *force, *moment);
            write.put(work.numbers, n);
            for (const auto* vector : {force, moment}) write.put(vector);
          });
        });
  // Rotation vectors (3) of rotations (3, 3).
  m.def("rotation_vectors", [](const In& rotations) {
    const Size count = rotations.size() / 9;
    expect_size(rotations, 9 * count);
    Out out = new_array(3, count);
    for (Size k = 0; k < count; ++k) {
      Mat3<double> R;
      Reader<double>{rotations.data() + k, count}.next(&R);
      const Vec3<double> turn = log3(R);
      Writer<double>{out.data() + k, count}.put(&turn);
    }
    return out;
  });
  // H_norm (1) of matrices (rows, n), then its gradient (rows, n).
  m.def("entropies", [](const In& matrices) {
    const auto [rows, n] = sizes(matrices);
    return stack({{matrices, rows * n}}, 1 + rows * n, [rows = rows, n = n](auto& work, auto& write) {
      work.matrix[0] = entropy(rows, n, work.arguments[0], work.matrix + 1);
      write.put(work.matrix, 1 + rows * n);
    });
  });
  // Singular values of matrices (rows, n), the largest first: min(rows, n) without vectors; with vectors n,
  // then V (n, n).
  m.def("singular_values", [](const In& matrices, bool vectors) {
    const auto [rows, n] = sizes(matrices);
    const int count = vectors ? n + n * n : std::min(rows, n);
    return stack({{matrices, rows * n}}, count, [vectors, rows = rows, n = n](auto& work, auto& write) {
      auto *C = work.arguments[0], *V = vectors ? work.matrix : nullptr;
      // The division by the largest entry prevents overflow and underflow of squares.
      auto largest = std::decay_t<decltype(*C)>(kTiny);
      for (int i = 0; i < rows * n; ++i) largest = larger(largest, magnitude(C[i]));
      write.put(work.numbers, singular_values(rows, n, C, V, work.numbers, largest));
      for (int i = 0; vectors && i < n * n; ++i) write.put(&V[i % n * n + i / n]);
    });
  });
  bind_clearance(m);
  bind_motions(m);
  bind_step(m);
}
