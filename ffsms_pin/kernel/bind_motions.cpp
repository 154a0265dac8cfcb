// Whole motions: the base's attitude along them, and their sums. Shapes are checked here.
#include <nanobind/stl/optional.h>

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "bindings.hpp"
#include "cone_march.hpp"
#include "quadrature.hpp"
#include "sums.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

using Array = nb::ndarray<const double, nb::device::cpu>;
using Packed = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Gradients = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Hessians = nb::ndarray<double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// Sizes of an array along its axes; zero: it has no such axis. An axis of one repeats.
struct Shape {
  Size component, joint, motion, instant;
};

// What was handed over, in forms that the kernel can read, kept until it is done.
class Given {
 public:
  Strided strided(nb::handle object, const Shape& shape, const char* name) {
    const Array& array = arrays_.emplace_back(nb::cast<Array>(object));
    Strided out;
    out.data = array.data();
    Size axis = array.ndim();
    const auto step = [&](Size size) -> std::ptrdiff_t {
      if (size == 0) return 0;
      if (axis == 0 || (array.shape(axis - 1) != size && array.shape(axis - 1) != 1)) wrong(name);
      --axis;
      return array.shape(axis) == 1 ? 0 : array.stride(axis);
    };
    out.instant = step(shape.instant);
    out.motion = step(shape.motion);
    out.joint = step(shape.joint);
    out.component = step(shape.component);
    if (axis != 0) wrong(name);
    return out;
  }

  const Packed& packed(nb::handle object, Size size, const char* name) {
    const Packed& array = packed_.emplace_back(nb::cast<Packed>(object));
    if (size != 0 && array.size() != size) wrong(name);
    return array;
  }

  const std::int64_t* indices(nb::handle object, Size count, Size end, const char* name) {
    const Indices& array = indices_.emplace_back(nb::cast<Indices>(object));
    if (array.shape(0) != count) wrong(name);
    for (Size i = 0; i < count; ++i) {
      if (array(i) < 0 || array(i) >= static_cast<std::int64_t>(end)) wrong(name);
    }
    return array.data();
  }

 private:
  static void wrong(const char* name) {
    throw std::invalid_argument(std::string(name) + " of a residual or a motion has a wrong shape");
  }

  std::deque<Array> arrays_;
  std::deque<Packed> packed_;
  std::deque<Indices> indices_;
};

Quadrature quadrature_of(Given& given, const nb::tuple& from) {
  const Packed& over = given.packed(from[1], 0, "integral_over");
  expect(over.ndim() == 2, "integral_over has two axes");
  Quadrature out;
  out.intervals = static_cast<int>(over.shape(0));
  out.gauss = static_cast<int>(over.shape(1));
  out.over = over.data();
  out.to_points = given.packed(from[0], over.size() * over.shape(1), "integral_to_points").data();
  out.late = nb::cast<int>(from[2]);
  return out;
}

SplineMaps maps_of(Given& given, const nb::tuple& from, Size instants) {
  const Packed& rates = given.packed(from[0], 0, "rates");
  expect(rates.ndim() == 2 && rates.shape(0) == instants, "the spline's rates have a wrong shape");
  SplineMaps out;
  out.size = static_cast<int>(rates.shape(1));
  out.rates = rates.data();
  out.travel = given.packed(from[1], rates.size(), "travel").data();
  out.accelerations = given.packed(from[2], rates.size(), "accelerations").data();
  return out;
}

// (instants, motion or None, weight, value, slopes by name)
Residual residual_of(Given& given, const nb::tuple& from, Size n, Size motions, Size instants) {
  Residual out;
  const Packed& weight = given.packed(from[2], 0, "weight");
  const Size count = weight.size(), S = from[1].is_none() ? motions : 0;
  out.count = static_cast<std::ptrdiff_t>(count);
  out.instants = given.indices(from[0], count, instants, "instants");
  out.motion = from[1].is_none() ? nullptr : given.indices(from[1], count, motions, "motion");
  out.weight = weight.data();
  out.value = given.strided(from[3], {0, 0, S, count}, "value");
  const Shape by_joint = {0, n, S, count}, by_vector = {3, 0, S, count};
  const struct {
    const char* name;
    Strided* slope;
    Shape shape;
  } named[] = {
      {"by_joints", &out.by_joints, by_joint},
      {"by_rates", &out.by_rates, by_joint},
      {"by_accelerations", &out.by_accelerations, by_joint},
      {"by_tip", &out.by_tip, by_vector},
      {"by_turn", &out.by_turn, by_vector},
      {"by_velocity", &out.by_velocity, by_vector},
      {"by_spin", &out.by_spin, by_vector},
      {"by_base", &out.by_base, by_vector},
      {"by_base_turn", &out.by_base_turn, by_vector},
      {"by_base_spin", &out.by_base_spin, by_vector},
      {"by_entropy", &out.by_entropy, {0, 0, S, count}},
      {"by_coupling", &out.by_coupling, {6, n, S, count}},
  };
  const nb::dict slopes = nb::cast<nb::dict>(from[4]);
  for (const auto& one : named) {
    if (slopes.contains(one.name)) *one.slope = given.strided(slopes[one.name], one.shape, one.name);
  }
  return out;
}

// (weight, value, by_position, by_rate, by_acceleration), the slopes None where there is none.
JointResidual joints_of(Given& given, const nb::tuple& from, const Shape& shape) {
  JointResidual out;
  out.count = static_cast<std::ptrdiff_t>(shape.instant);
  out.weight = given.packed(from[0], shape.instant, "weight").data();
  const auto part = [&](int i, const char* name) {
    return from[i].is_none() ? Strided() : given.strided(from[i], shape, name);
  };
  out.value = part(1, "value");
  out.by_position = part(2, "by_position");
  out.by_rate = part(3, "by_rate");
  out.by_acceleration = part(4, "by_acceleration");
  return out;
}

// Attitudes (3, 3, S, K) of the base, and what momentum adds to its angular velocity (3, S, K).
void spline_attitudes(const nb::tuple& quadrature, const nb::tuple& arm, const In& start,
                      const nb::object& momentum, const Out& attitude, const Out& own) {
  Given given;
  const Quadrature by = quadrature_of(given, quadrature);
  const Array rates = nb::cast<Array>(arm[0]);
  expect(rates.ndim() == 3, "rates have three axes");
  const Size n = rates.shape(0), S = rates.shape(1), K = static_cast<Size>(by.instants());
  const Strided u = given.strided(arm[0], {0, n, S, K}, "rates");
  const Strided spin = given.strided(arm[1], {3, n, S, K}, "spin");
  const Strided inverse = given.strided(arm[2], {3, 3, S, K}, "inverse");
  expect_rows(start, 3, 3);
  expect_rows(attitude, 9, S * K);
  expect_rows(own, 3, S * K);
  const Mat3<double> first = matrix({start.data(), 3, 1, 0, 0});
  const bool drifts = !momentum.is_none();
  const double* angular = drifts ? given.packed(momentum, 3, "momentum").data() : nullptr;
  std::vector<Vec3<double>> omega(K), added(K, zero3<double>()), spins(K);
  std::vector<Mat3<double>> turned(K), before(K), inverses(K);
  for (Size s = 0; s < S; ++s) {
    for (Size k = 0; k < K; ++k) {
      const Strided rate = u.at(s, k), column = spin.at(s, k);
      omega[k] = zero3<double>();
      for (int j = 0; j < static_cast<int>(n); ++j) {
        for (int x = 0; x < 3; ++x) omega[k][x] += column(x, j) * rate(0, j);
      }
      if (drifts) inverses[k] = matrix(inverse.at(s, k));
    }
    if (drifts) {
      const Vec3<double> total = {{angular[0], angular[1], angular[2]}};
      drifting_attitudes(by, first, omega.data(), inverses.data(), total, turned.data(), added.data(),
                         spins.data(), before.data());
    } else {
      base_attitudes(by, first, omega.data(), turned.data());
    }
    for (Size k = 0; k < K; ++k) {
      for (int x = 0; x < 3; ++x) {
        own(x, s * K + k) = added[k][x];
        for (int y = 0; y < 3; ++y) attitude(3 * x + y, s * K + k) = turned[k][x][y];
      }
    }
  }
}

void sums(const Tree& tree, const nb::tuple& maps, const nb::tuple& quadrature, const nb::tuple& motions,
          const nb::list& residuals, const nb::list& of_joints, const Indices& chosen,
          const Gradients& gradient, const Hessians& hessian) {
  Given given;
  const Quadrature by = quadrature_of(given, quadrature);
  const Size n = static_cast<Size>(tree.n), K = static_cast<Size>(by.instants());
  const SplineMaps spline = maps_of(given, maps, K);
  const Size size = n * static_cast<Size>(spline.size), S = nb::cast<Array>(motions[0]).shape(1);
  const ArmMotions arm = {
      given.strided(motions[0], {0, n, S, K}, "joints"), given.strided(motions[1], {0, n, S, K}, "rates"),
      given.strided(motions[2], {3, 3, S, K}, "base_attitude"),
      given.strided(motions[3], {3, 0, S, K}, "own_spin"),
      motions[4].is_none() ? Strided() : given.strided(motions[4], {6, n, S, K}, "entropy_slope")};
  std::vector<Residual> values;
  std::vector<JointResidual> single;
  for (nb::handle one : residuals) values.push_back(residual_of(given, nb::cast<nb::tuple>(one), n, S, K));
  for (nb::handle one : of_joints) single.push_back(joints_of(given, nb::cast<nb::tuple>(one), {0, n, S, K}));
  const Size count = chosen.shape(0);
  expect(gradient.shape(0) == count && gradient.shape(1) == size, "the gradient has a wrong shape");
  expect(hessian.shape(0) == count && hessian.shape(1) == size && hessian.shape(2) == size,
         "the Hessian has a wrong shape");
  for (Size i = 0; i < count; ++i) expect(chosen(i) >= 0 && Size(chosen(i)) < S, "no such motion");
  Sums all(tree, arm, spline, by);
  for (Size i = 0; i < count; ++i) {
    all.add(chosen(i), values, single, gradient.data() + i * size, hessian.data() + i * size * size);
  }
}

// Joint rates (S, steps n) of marches to the sides (S, 3). `joints` are positions, limits and greatest rates
// (4, n); `places` the target, the centre of mass and its drift (3, 3).
void cone_marches(const Tree& tree, int steps, double duration, double kappa, double mean_speed,
                  double arrival_power, double least_approach, double damping, const In& joints,
                  const In& places, const In& attitude, const std::optional<In>& rotation, const In& sides,
                  const Out& rates) {
  const Size n = static_cast<Size>(tree.n);
  expect_rows(joints, 4, n);
  expect_rows(places, 3, 3);
  expect_rows(attitude, 3, 3);
  if (rotation) expect_rows(*rotation, 3, 3);
  expect(sides.shape(1) == 3, "sides have three components");
  expect_rows(rates, static_cast<int>(sides.shape(0)), n * static_cast<Size>(steps));
  const auto row = [](const In& of, int i) { return vector({of.data() + 3 * i, 1, 0, 0, 0}); };
  const auto turn = [](const In& of) { return matrix({of.data(), 3, 1, 0, 0}); };
  ConeMarch by = {};
  by.duration = duration;
  by.steps = steps;
  by.kappa = kappa;
  by.mean_speed = mean_speed;
  by.arrival_power = arrival_power;
  by.least_approach = least_approach;
  by.damping = damping;
  by.target = row(places, 0);
  by.com = row(places, 1);
  by.drift = row(places, 2);
  by.attitude = turn(attitude);
  by.posed = rotation.has_value();
  if (rotation) by.rotation = turn(*rotation);
  by.start = joints.data();
  by.low = by.start + n;
  by.high = by.low + n;
  by.most = by.high + n;
  for (Size s = 0; s < sides.shape(0); ++s) {
    cone_march(tree, by, row(sides, static_cast<int>(s)), rates.data() + s * rates.shape(1));
  }
}

}  // namespace

void bind_motions(nb::module_& m) {
  m.def("spline_attitudes", &spline_attitudes, nb::arg("quadrature"), nb::arg("arm"), nb::arg("start"),
        nb::arg("momentum").none(), nb::arg("attitude"), nb::arg("own"));
  m.def("sums", &sums, nb::arg("tree"), nb::arg("maps"), nb::arg("quadrature"), nb::arg("motions"),
        nb::arg("residuals"), nb::arg("of_joints"), nb::arg("chosen"), nb::arg("gradient"),
        nb::arg("hessian"));
  m.def("cone_marches", &cone_marches, nb::arg("tree"), nb::arg("steps"), nb::arg("duration"),
        nb::arg("kappa"), nb::arg("mean_speed"), nb::arg("arrival_power"), nb::arg("least_approach"),
        nb::arg("damping"), nb::arg("joints"), nb::arg("places"), nb::arg("attitude"),
        nb::arg("rotation").none(), nb::arg("sides"), nb::arg("rates"));
}

}  // namespace ffsms
