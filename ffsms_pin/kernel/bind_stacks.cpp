// The robot, and functions of it at stacks of configurations: from arrays (rows, ...) to new ones (rows, B).
#include "arrays.hpp"
#include "dynamics.hpp"
#include "entropy.hpp"

namespace ffsms {
namespace {

// Of a joint's axis, as Pinocchio's Jacobian gives it.
constexpr double kAxisRounding = 1e-14;
constexpr double kTiny = 1e-300;  // nothing is divided by less

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
// base first: mass, lever (3), inertia about the centre of mass (9). `tip`: place and attitude.
Tree made(const Table<double, -1, 18>& joints, const Table<double, -1, 13>& bodies,
          const Table<double, 1, 12>& tip, int last, bool moves, bool turns_freely) {
  const int n = static_cast<int>(joints.shape(0));
  expect(n >= 1 && n <= kMostJoints, "the kernel takes 1 to 64 joints");
  expect(bodies.shape(0) == joints.shape(0) + 1, "an array has a wrong shape");
  expect(last >= -1 && last < n, "the end effector's joint is not there");
  Tree tree = {};
  tree.n = n;
  tree.last = last;
  tree.tip_in_last = vector_at(tip.data());
  tree.tip_turn = matrix_at(tip.data() + 3);
  const double* base = bodies.data();
  tree.total_mass = base[0];
  tree.base_com = vector_at(base + 1);
  tree.base_moment = base[0] * tree.base_com;
  tree.base_inertia = matrix_at(base + 4);
  add_steiner(tree.base_inertia, base[0], tree.base_com);
  for (int j = 0; j < n; ++j) {
    Joint& joint = tree.joints[j];
    const double *row = joints.data() + 18 * j, *body = bodies.data() + 13 * (j + 1);
    joint.parent = static_cast<int>(row[0]);
    expect(joint.parent >= -1 && joint.parent < j, "a joint comes before the one that carries it");
    joint.turns = row[1] != 0.0;
    joint.moves_tip = row[2] != 0.0;
    joint.axis = vector_at(row + 3);
    joint.own_axis = own_axis(joint.axis);
    joint.offset = vector_at(row + 6);
    joint.placement = matrix_at(row + 9);
    joint.mass = body[0];
    joint.lever = vector_at(body + 1);
    joint.inertia = matrix_at(body + 4);
    tree.total_mass += body[0];
    for (int i = j; i >= 0; i = tree.joints[i].parent) tree.joints[i].carried_mass += body[0];
  }
  tree.moves = moves;
  tree.turns_freely = turns_freely;
  tree.inverse_mass = moves ? 1.0 / tree.total_mass : 0.0;
  return tree;
}

// Room to work in, at one configuration or a pack of them: what was given, and what comes of it.
template <class T>
struct Work {
  T given[6][kMostJoints], rates[kMostJoints], accelerations[kMostJoints];
  Vec3<T> own_spin;
  Arm<T> arm;
  Vec3<T> first[kMostJoints], second[kMostJoints], force, moment;
  T rows[kMostJoints][kMostJoints], gradient[kMostRows][kMostJoints], sigma[kMostJoints], value;
};

// Rows (B) that `use(work, k, writer)` writes at one configuration, or pack of them, after the other.
template <class Use>
Out stack(Size count, int rows, const Use& use) {
  Out out = new_array(rows, count);
  const nb::gil_scoped_release quiet;
  along<Work>(count, [&](auto& work, Size k) {
    Writer write = {out.data() + k, count};
    use(work, k, write);
  });
  return out;
}

// The same where the arm is at joint positions: evaluated, which is quicker than to read what it was.
template <class Use>
Out at_each(const Tree& tree, const In& positions, int rows, const Use& use) {
  const Size n = static_cast<Size>(tree.n), count = positions.size() / n;
  expect(positions.ndim() > 0 && positions.shape(0) == n, "an array has a wrong shape");
  return stack(count, rows, [&](auto& work, Size k, Writer& write) {
    Reader{positions.data() + k, count}.next(work.given[0], tree.n);
    evaluate(tree, work.given[0], work.arm);
    use(work, k, write);
  });
}

// And at rates.
template <class Use>
Out moving(const Tree& tree, const In& positions, const In& rates, int rows, const Use& use) {
  expect_size(rates, positions.size());
  const Size count = positions.size() / static_cast<Size>(tree.n);
  return at_each(tree, positions, rows, [&](auto& work, Size k, Writer& write) {
    Reader{rates.data() + k, count}.next(work.rates, tree.n);
    use(work, k, write);
  });
}

// What `ArmValues` holds beside the positions, in its order: 42 n + 27 rows.
Out arm_values(const Tree& tree, const In& positions) {
  const int n = tree.n;
  return at_each(tree, positions, 42 * n + 27, [n](auto& work, Size, Writer& write) {
    auto& arm = work.arm;
    for (const auto* columns : {arm.axis, arm.velocity, arm.linear, arm.angular}) write.put(columns, n);
    write.put(&arm.com, 1);
    write.put(&arm.inverse, 1);
    write.put(arm.spin, n);
    write.put(arm.root, n);
    write.put(&arm.tip, 1);
    write.put(&arm.tip_rotation, 1);
    write.put(arm.tip_velocity, n);
    write.put(arm.jstar, n);
    for (const auto& row : arm.coupling) write.put(row, n);
    for (int x = 0; x < 3; ++x) {
      for (int j = 0; j < n; ++j) write.put(&arm.origin[j][x], 1);
      write.put(&arm.tip[x], 1);
    }
    write.put(arm.rotation, n);
  });
}

// C_bm and J* (6, n), the end effector from the base's centre of mass: 12 n + 3 rows.
Out coupled(const Tree& tree, const In& positions) {
  const int n = tree.n;
  return at_each(tree, positions, 12 * n + 3, [&](auto& work, Size, Writer& write) {
    auto& arm = work.arm;
    for (const auto& row : arm.coupling) write.put(row, n);
    write.put(arm.jstar, n);
    for (int j = 0; j < n; ++j) {
      work.first[j] = arm.spin[j];
      if (tree.joints[j].moves_tip) work.first[j] += arm.axis[j];
    }
    write.put(work.first, n);
    for (int x = 0; x < 3; ++x) arm.tip[x] = arm.tip[x] - tree.base_com[x];
    write.put(&arm.tip, 1);
  });
}

// J_m (6, n), on a fixed base.
Out manipulator_jacobian(const Tree& tree, const In& positions) {
  return at_each(tree, positions, 6 * tree.n, [&](auto& work, Size, Writer& write) {
    write.put(work.arm.tip_velocity, tree.n);
    for (int j = 0; j < tree.n; ++j) {
      if (!tree.joints[j].moves_tip) work.arm.axis[j] = decltype(work.own_spin){};
    }
    write.put(work.arm.axis, tree.n);
  });
}

// H_q (n, n).
Out reduced(const Tree& tree, const In& positions) {
  return at_each(tree, positions, tree.n * tree.n, [&](auto& work, Size, Writer& write) {
    reduced_inertia(tree, work.arm, work.rows);
    for (int i = 0; i < tree.n; ++i) write.put(work.rows[i], tree.n);
  });
}

// Of the base's angular velocity and of the end effector's velocity (3, n) each.
Out velocities(const Tree& tree, const In& positions, const In& rates) {
  return moving(tree, positions, rates, 6 * tree.n, [&](auto& work, Size, Writer& write) {
    velocity_slopes(tree, work.arm, work.rates, work.first, work.second);
    write.put(work.first, tree.n);
    write.put(work.second, tree.n);
  });
}

// Of the angular momentum (3, n) while the base's attitude is held.
Out momenta(const Tree& tree, const In& positions, const In& rates) {
  return moving(tree, positions, rates, 3 * tree.n, [&](auto& work, Size, Writer& write) {
    momentum_slopes(tree, work.arm, work.rates, work.first);
    write.put(work.first, tree.n);
  });
}

// Gradient (n) of a function of the coupling with slopes (6, n).
Out couplings(const Tree& tree, const In& positions, const In& by_coupling) {
  expect_size(by_coupling, 6 * positions.size());
  const Size count = positions.size() / static_cast<Size>(tree.n);
  return at_each(tree, positions, tree.n, [&](auto& work, Size k, Writer& write) {
    Reader read = {by_coupling.data() + k, count};
    for (auto& row : work.given) read.next(row, tree.n);
    coupling_slopes(tree, work.arm, work.given, work.sigma);
    write.put(work.sigma, tree.n);
  });
}

// Torques of the joints (n), force and moment (6) that hold the base.
Out forces(const Tree& tree, const In& positions, const In& rates, const In& accelerations,
           const In& own_spin) {
  expect_size(accelerations, positions.size());
  const Size count = positions.size() / static_cast<Size>(tree.n);
  expect_size(own_spin, 3 * count);
  return moving(tree, positions, rates, tree.n + 6, [&](auto& work, Size k, Writer& write) {
    Reader{accelerations.data() + k, count}.next(work.accelerations, tree.n);
    Reader{own_spin.data() + k, count}.next(work.own_spin.v, 3);
    dynamics(tree, work.arm, work.rates, work.accelerations, work.own_spin, work.sigma, work.force,
             work.moment);
    write.put(work.sigma, tree.n);
    write.put(&work.force, 1);
    write.put(&work.moment, 1);
  });
}

// H_norm of matrices (rows, n, ...): one row, then rows n of its gradient.
Out entropies(const In& coupling) {
  expect(coupling.ndim() >= 2, "matrices have two axes");
  const Size rows = coupling.shape(0), n = coupling.shape(1);
  expect(rows >= 1 && rows <= kMostRows && n >= 1 && n <= kMostJoints, "too many rows or joints");
  const Size count = coupling.size() / (rows * n);
  const int m = static_cast<int>(rows), k = static_cast<int>(n);
  return stack(count, 1 + m * k, [&](auto& work, Size at, Writer& write) {
    Reader read = {coupling.data() + at, count};
    for (int i = 0; i < m; ++i) read.next(work.given[i], k);
    work.value = entropy(m, k, work.given, work.gradient);
    write.put(&work.value, 1);
    for (int i = 0; i < m; ++i) write.put(work.gradient[i], k);
  });
}

// Singular values of matrices (rows, n, ...), the largest first; without vectors the lesser of rows and n.
// With vectors n of them, then V (n, n).
Out singular_values(const In& matrices, bool vectors) {
  expect(matrices.ndim() >= 2, "matrices have two axes");
  const Size rows = matrices.shape(0), n = matrices.shape(1);
  expect(rows >= 1 && n >= 1 && n <= kMostJoints && rows <= kMostRows, "the matrices are too large");
  const Size count = matrices.size() / (rows * n);
  const bool by_rows = !vectors && rows < n;
  const int r = static_cast<int>(rows), c = static_cast<int>(n);
  const int k = by_rows ? r : c, m = by_rows ? c : r;
  return stack(count, vectors ? k + k * k : k, [&](auto& work, Size at, Writer& write) {
    Reader read = {matrices.data() + at, count};
    auto *A = work.given[0], *V = vectors ? work.rows[0] : nullptr;
    for (int i = 0; i < r; ++i) {
      for (int j = 0; j < c; ++j) read.next(&A[by_rows ? i * m + j : j * m + i], 1);
    }
    // So that no square overflows, or vanishes.
    auto largest = std::decay_t<decltype(work.value)>(kTiny);
    for (int i = 0; i < r * c; ++i) largest = larger(largest, magnitude(A[i]));
    for (int i = 0; i < r * c; ++i) A[i] = A[i] / largest;
    decompose(m, k, A, m, V, work.sigma);
    for (int i = 0; i < k; ++i) work.sigma[i] = largest * work.sigma[i];
    sort(k, work.sigma, V);
    write.put(work.sigma, k);
    for (int i = 0; vectors && i < k; ++i) {
      for (int j = 0; j < k; ++j) write.put(&V[j * k + i], 1);
    }
  });
}

}  // namespace

void bind_stacks(nb::module_& m) {
  nb::class_<Tree>(m, "Tree", "The robot in plain numbers.")
      .def("__init__",
           [](Tree* self, const Table<double, -1, 18>& joints, const Table<double, -1, 13>& bodies,
              const Table<double, 1, 12>& tip, int last, bool moves,
              bool turns_freely) { new (self) Tree(made(joints, bodies, tip, last, moves, turns_freely)); })
      .def_ro("n", &Tree::n)
      .def("__getstate__", [](const Tree& self) { return nb::bytes(&self, sizeof self); })
      .def("__setstate__", [](Tree& self, const nb::bytes& state) {
        expect(state.size() == sizeof(Tree), "a tree of another build");
        std::memcpy(static_cast<void*>(&self), state.data(), sizeof(Tree));
      });
  m.def("arm_values", &arm_values);
  m.def("coupled", &coupled);
  m.def("manipulator_jacobian", &manipulator_jacobian);
  m.def("reduced_inertia", &reduced);
  m.def("velocity_slopes", &velocities);
  m.def("momentum_slopes", &momenta);
  m.def("coupling_slopes", &couplings);
  m.def("dynamics", &forces);
  m.def("entropies", &entropies);
  m.def("singular_values", &singular_values);
}

}  // namespace ffsms
