// Bindings of clearance.hpp for ffsms_pin/geometry: distances of pairs of bodies, and their gradients.
#include "arrays.hpp"
#include "clearance.hpp"

namespace ffsms {
namespace {

// The arm and the obstacles at one of the joint positions (n, count). `select` selects the configuration, and
// `evaluate_pose` evaluates the arm.
struct ArmAt {
  const Tree& tree;
  const Matrix& joints;
  Table<double, 3, 3, -1, -1> turns;
  Table<double, 3, -1, -1> origins;
  Arm<double> arm;
  double positions[kMostJoints] = {};
  Index last = -1;
  bool posed = false;

  ArmAt(const Tree& robot, const Matrix& stack, Table<double, 3, 3, -1, -1> axes = {},
        Table<double, 3, -1, -1> places = {})
      : tree(robot), joints(stack), turns(axes), origins(places) {
    expect(joints.shape(0) == static_cast<Size>(tree.n), "an array has a wrong shape");
  }
  // Selects configuration k; returns true if it differs from the last one.
  bool select(Index k) {
    if (k == last) return false;
    Reader<double>{joints.data() + k, joints.shape(1)}.next(positions, tree.n);
    last = k;
    posed = false;
    return true;
  }
  // Evaluates the arm at the selected configuration; returns false if it is already evaluated.
  bool evaluate_pose() {
    if (posed) return false;
    pose(tree, positions, arm);
    return posed = true;
  }
  // Returns the pose, relative to the root frame, of the base (-1), of a body of the arm, or of an obstacle
  // (indices from n on).
  Placed body(Index index) const {
    if (index < 0) return {{{{{1.0, 0.0, 0.0}}, {{0.0, 1.0, 0.0}}, {{0.0, 0.0, 1.0}}}}, {}};
    if (index < tree.n) return {arm.rotation[index], arm.origin[index]};
    Placed pose;
    const Index m = index - tree.n;
    const Size count = origins.shape(1) * origins.shape(2);
    Reader<double>{&turns(0, 0, m, last), count}.next(&pose.turn);
    Reader<double>{&origins(0, m, last), count}.next(&pose.origin);
    return pose;
  }
};

constexpr double kExact = 1e-7;  // [m] a distance is exact if its bounds differ by less

// Returns distances (V) and nearest points (V, 3, 3), in the first body's axes, of V entries (pair of bodies,
// configuration). A distance that is not below `near` is a lower bound without points.
//
// If the bounds of a distance are not equal, because parts overlap or a part has no corners, coal must
// measure it. For each such entry the third result has the index of the entry, the lower bounds and indices
// of pairs of parts, and the pose (12,) of the second body relative to the first (attitude, then position).
//
// `reaches` (pairs, n) are upper bounds of the rate of each distance per unit rate of each joint. With these
// bounds most pairs need not be measured again at the next configuration.
nb::tuple near_parts(const Tree& tree, Matrix joints, Table<double, 3, 3, -1, -1> turns,
                     Table<double, 3, -1, -1> origins, Indices columns, Indices at, Vector near,
                     Table<double, -1, 17> bodies, Table<double, -1, 17> parts, Table<Index, -1, 2> ends,
                     Indices starts, Table<Index, -1, 2> pairs, Table<double, -1, 3> corners, Indices begins,
                     Table<double, -1, 5> rounds, Matrix reaches) {
  ArmAt arm(tree, joints, turns, origins);
  const auto* cover = reinterpret_cast<const Cover*>(bodies.data());
  const auto* part = reinterpret_cast<const Cover*>(parts.data());
  const auto* corner = reinterpret_cast<const Vec3<double>*>(corners.data());
  const auto hull = [&](Index p) {
    const double* round = rounds.data() + 5 * p;
    return Hull{corner + begins(p), begins(p + 1) - begins(p), round[0], round[1],
                of_numbers<Vec3<double>>(round + 2)};
  };
  std::vector<Placed> placed(bodies.shape(0));
  std::vector<Vec3<double>> centres(bodies.shape(0)), directions(pairs.shape(0), Vec3<double>{});
  std::vector<std::pair<double, Index>> close;  // lower bounds and pairs of parts below `near`
  // The entry of the last measurement of each pair of bodies, and a bound of the change of distance since
  // then.
  std::vector<Size> last_entry(ends.shape(0), 0);
  std::vector<double> change_bound(last_entry.size(), kInfinity);
  const Size size = columns.shape(0), n = static_cast<Size>(tree.n);
  expect(reaches.shape(0) == last_entry.size() && reaches.shape(1) == n, "an array has a wrong shape");
  const double* reach = reaches.data();
  Out distance = new_array(size), points = new_array(size, 3, 3);
  std::fill_n(distance.data(), size, 0.0);
  std::fill_n(points.data(), points.size(), 0.0);
  nb::list entries;
  for (Size v = 0; v < size; ++v) {
    const Index m = columns(v), first = ends(m, 0), second = ends(m, 1);
    double displacement[kMostJoints];
    std::copy_n(arm.positions, n, displacement);
    if (arm.select(at(v))) {
      for (Size j = 0; j < n; ++j) displacement[j] = std::fabs(arm.positions[j] - displacement[j]);
      for (Size i = 0; i < last_entry.size(); ++i) {
        double most = origins.shape(1) > 0 ? kInfinity : 0.0;  // reaches do not bound obstacles' motion
        for (Size j = 0; j < n; ++j) most += reach[i * n + j] * displacement[j];
        change_bound[i] += most;
      }
    }
    double& least = distance.data()[v];
    least = distance.data()[last_entry[m]] - change_bound[m];
    last_entry[m] = v;
    change_bound[m] = 0.0;
    if (least >= near(v)) continue;
    if (arm.evaluate_pose()) {
      for (Size b = 0; b < placed.size(); ++b) {
        placed[b] = arm.body(static_cast<Index>(cover[b].body));
        centres[b] = placed[b].origin + placed[b].turn * cover[b].centre;
      }
    }
    const Vec3<double> between_centres = centres[second] - centres[first];
    least = std::sqrt(dot(between_centres, between_centres)) - cover[first].radius - cover[second].radius;
    if (!(least < near(v))) continue;
    const Mat3<double> back = transposed(placed[first].turn);
    const Placed relative = {back * placed[second].turn,
                             back * (placed[second].origin - placed[first].origin)};
    least = bound(cover[first], cover[second], relative, near(v));
    if (!(least < near(v))) continue;
    close.clear();
    double beyond = kInfinity, most = near(v);
    for (Index i = starts(m); i < starts(m + 1); ++i) {
      const double low = bound(part[pairs(i, 0)], part[pairs(i, 1)], relative, near(v));
      if (low < near(v))
        close.emplace_back(low, i);
      else
        beyond = std::min(beyond, low);
    }
    std::sort(close.begin(), close.end());
    nb::list unmeasured;
    for (const auto& [low, i] : close) {
      if (!(low < most)) break;
      const Gap between = gap(hull(pairs(i, 0)), hull(pairs(i, 1)), relative, most, directions[i]);
      if (between.lower >= most) {
        beyond = std::min(beyond, between.lower);
      } else if (between.upper - between.lower < kExact) {
        most = between.upper;
        std::memcpy(points.data() + 9 * v, &between.nearest, sizeof between.nearest);
      } else {
        unmeasured.append(nb::make_tuple(std::max(low, between.lower), i));
      }
    }
    least = most < near(v) || unmeasured.size() > 0 ? most : std::max(least, beyond);
    if (unmeasured.size() == 0) continue;
    entries.append(nb::make_tuple(v, unmeasured, array_of(relative)));
    change_bound[m] = kInfinity;
  }
  return nb::make_tuple(distance, points, entries);
}

// Returns distances (V) and nearest points (V, 3, 3) of the paper's points. A row of `ends` has the index of
// a point (the joints' origins, then the end effector), and the index of another point, or -1 for the box.
nb::tuple near_points(const Tree& tree, Matrix joints, Indices columns, Indices at, Table<Index, -1, 2> ends,
                      const Box& box) {
  ArmAt arm_at(tree, joints);
  const Size size = columns.shape(0);
  Out distance = new_array(size), points = new_array(size, 3, 3);
  for (Size v = 0; v < size; ++v) {
    arm_at.select(at(v));
    arm_at.evaluate_pose();
    const Index point = ends(columns(v), 0), other = ends(columns(v), 1);
    Nearest nearest = {{}, arm_at.arm.origin[point], {}};
    if (other >= 0) nearest.on_first = arm_at.arm.origin[other];
    distance.data()[v] = other < 0 ? from_box(box, nearest) : from_point(nearest);
    std::memcpy(points.data() + 9 * v, &nearest, sizeof nearest);
  }
  return nb::make_tuple(distance, points);
}

// Returns the gradients (n, V) of distances by the joint positions on a fixed base, and in base axes the
// nearest points and the normal (3, 3, V). A row of `bodies` (m, 3) has the two bodies of a pair, and the
// body in whose axes the entries of `points` (V, 3, 3) are.
nb::tuple distance_slopes(const Tree& tree, Matrix joints, Table<Index, -1, 3> bodies, Indices columns,
                          Indices at, Table<double, -1, 3, 3> points) {
  ArmAt arm_at(tree, joints);
  const Size size = at.shape(0);
  const auto count = static_cast<Index>(size);
  Out gradient = new_array(tree.n, size), placed = new_array(3, 3, size);
  std::fill_n(gradient.data(), gradient.size(), 0.0);
  for (Size v = 0; v < size; ++v) {
    arm_at.select(at(v));
    arm_at.evaluate_pose();
    const Index* pair = bodies.data() + 3 * columns(v);
    auto nearest = of_numbers<Nearest>(points.data() + 9 * v);
    const Placed body = arm_at.body(pair[2]);
    nearest = {body.origin + body.turn * nearest.on_first, body.origin + body.turn * nearest.on_second,
               body.turn * nearest.normal};
    add_slopes(tree, arm_at.arm, pair[1], nearest.on_second, nearest.normal, 1.0, gradient.data() + v, count);
    add_slopes(tree, arm_at.arm, pair[0], nearest.on_first, nearest.normal, -1.0, gradient.data() + v, count);
    Writer<double>{placed.data() + v, size}.put(&nearest);
  }
  return nb::make_tuple(gradient, placed);
}

}  // namespace

void bind_clearance(nb::module_& m) {
  m.def("near_points", &near_points);
  m.def("distance_slopes", &distance_slopes);
  m.def("near_parts", &near_parts);
}

}  // namespace ffsms
