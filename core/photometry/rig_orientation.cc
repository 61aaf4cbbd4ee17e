#include "core/photometry/rig_orientation.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <utility>

namespace omnihdr {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
constexpr int kLeastSamplesOfAPatch = 12;
constexpr std::size_t kLeastShared = 50;  // directions, for two sensors to be neighbours
// Of the largest value: what is brighter may be clipped, what is darker is noise.
constexpr double kBright = 0.97;
constexpr double kDark = 0.012;
constexpr double kNoiseFloor = 0.02;  // spread of the logarithm that says nothing

// Directions evenly over the sphere (Fibonacci's lattice).
std::vector<Eigen::Vector3d> Directions(double spacing_deg) {
  const double spacing = spacing_deg * kPi / 180.0;
  const auto count = static_cast<int>(std::lround(4.0 * kPi / (spacing * spacing)));
  const double golden = kPi * (3.0 - std::sqrt(5.0));
  std::vector<Eigen::Vector3d> directions;
  directions.reserve(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / count;
    const double r = std::sqrt(1.0 - z * z);
    directions.emplace_back(r * std::cos(golden * i), r * std::sin(golden * i), z);
  }
  return directions;
}

// Which cell of a cube's faces, `cells` a side and of about even angle, a direction is in, and
// where in it, from its middle.
struct Cell {
  int index = 0;
  float u = 0.0F;
  float v = 0.0F;
};
Cell CellOf(const Eigen::Vector3d& d, int cells) {
  int axis = 0;
  d.cwiseAbs().maxCoeff(&axis);
  const double depth = std::abs(d[axis]);
  const auto place = [&](double value, float* within) {
    const double share = (0.5 + std::atan(value / depth) * 2.0 / kPi) * cells;
    const int cell = std::clamp(static_cast<int>(share), 0, cells - 1);
    *within = static_cast<float>(share - cell - 0.5);
    return cell;
  };
  Cell cell;
  const int face = 2 * axis + (d[axis] > 0.0 ? 0 : 1);
  const int across = place(d[(axis + 1) % 3], &cell.u);
  const int along = place(d[(axis + 2) % 3], &cell.v);
  cell.index = (face * cells + across) * cells + along;
  return cell;
}

// Pixels that an angle covers in the middle of a picture; even, so that mosaics become grey.
int PixelsOf(const Lens& lens, double angle_deg) {
  constexpr double kHalf = 4.0;
  const Eigen::Vector2d middle(0.5 * lens.width(), 0.5 * lens.height());
  const auto left = lens.RayFromPixel(middle.x() - kHalf, middle.y());
  const auto right = lens.RayFromPixel(middle.x() + kHalf, middle.y());
  if (!left || !right) return 2;
  const double angle = std::acos(std::clamp(left->dot(*right), -1.0, 1.0)) * 180.0 / kPi;
  const double pixels = angle > 0.0 ? 2.0 * kHalf * angle_deg / angle : 2.0;
  return std::max(2, 2 * static_cast<int>(std::lround(0.5 * pixels)));
}

std::string Named(const Rig& rig, int sensor) {
  return fmt::format("\"{}\"", rig.sensors[static_cast<std::size_t>(sensor)].name);
}

// The mean of each block of pixels as its logarithm.
template <typename Value>
Image<float> Reduce(ImageView<const Value> picture, int block) {
  constexpr double kMost = std::numeric_limits<Value>::max();
  const int columns = std::max(1, picture.width() / block);
  const int rows = std::max(1, picture.height() / block);
  Image<float> out(columns, rows);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      double sum = 0.0;
      int outside = 0;  // of what tells: clipped, dark, or where the lens shows nothing
      for (int y = row * block; y < (row + 1) * block && y < picture.height(); ++y) {
        for (int x = column * block; x < (column + 1) * block && x < picture.width(); ++x) {
          const double value = picture.at(x, y);
          sum += value;
          outside += value > kBright * kMost || value < kDark * kMost ? 1 : 0;
        }
      }
      const double mean = sum / (block * block);
      const bool says = outside * 10 <= block * block;
      out.at(column, row) = says ? static_cast<float>(std::log(mean)) : kNothing;
    }
  }
  return out;
}

// Sums of the products of 1, u, v and the two sensors' values over a patch.
using Sums = Eigen::Matrix<double, 5, 5>;

// Covariance of the two values without what a plane over the patch explains of each.
Eigen::Matrix2d WithoutPlane(const Sums& sums) {
  const Eigen::Matrix3d plane = sums.topLeftCorner<3, 3>();
  const Eigen::Matrix<double, 3, 2> with = sums.topRightCorner<3, 2>();
  const Eigen::Matrix2d rest =
      sums.bottomRightCorner<2, 2>() - with.transpose() * plane.ldlt().solve(with);
  return rest / sums(0, 0);
}

}  // namespace

Status OrientationOptions::Validate() const {
  const auto check = [](const char* name, double value, double low, double high) -> Status {
    if (value >= low && value <= high) return {};
    return Fail(ErrorKind::kUsage, "{}: {}: expected {} to {}", name, value, low, high);
  };
  OMNIHDR_TRY(check("sample_deg", sample_deg, 0.2, 5.0));
  OMNIHDR_TRY(check("patch_deg", patch_deg, 4.0 * sample_deg, 45.0));
  OMNIHDR_TRY(check("texture", texture, 0.001, 1.0));
  OMNIHDR_TRY(check("least_patches", least_patches, 1, 10000));
  OMNIHDR_TRY(check("least_compared", least_compared, 1, 100000));
  OMNIHDR_TRY(check("agrees", agrees, 0.0, 1.0));
  OMNIHDR_TRY(check("contradicts", contradicts, 0.0, 1.0));
  OMNIHDR_TRY(check("clearly_better", clearly_better, 0.0, 2.0));
  return check("about_equal", about_equal, 0.0, 1.0);
}

std::string_view ToString(OrientationVerdict verdict) {
  switch (verdict) {
    case OrientationVerdict::kUndecided:
      return "undecided";
    case OrientationVerdict::kAgrees:
      return "agrees";
    case OrientationVerdict::kContradicted:
      return "contradicted";
  }
  return "unknown";
}

std::string OrientationReport::Text() const {
  const std::string seen = fmt::format("agreement {:.2f} in {} patches of {} frames",
                                       configured.agreement, configured.patches, frames);
  if (verdict == OrientationVerdict::kAgrees) {
    return fmt::format("neighbouring sensors show the same under the calibration ({})", seen);
  }
  if (verdict == OrientationVerdict::kUndecided) {
    return fmt::format("what two sensors see does not tell whether the calibration fits ({})",
                       seen);
  }
  std::string whats;
  for (const OrientationAlternative& each : best) {
    whats += fmt::format("{}{} ({:.2f})", whats.empty() ? "" : ", or ", each.what, each.agreement);
  }
  return fmt::format("neighbouring sensors contradict the calibration ({}); they would agree if {}",
                     seen, whats);
}

Result<OrientationCheck> OrientationCheck::Create(const Rig& rig,
                                                  const OrientationOptions& options) {
  OMNIHDR_TRY(options.Validate());
  OMNIHDR_TRY(rig.Validate());
  OrientationCheck check;
  check.options_ = options;
  check.rig_ = rig;
  const std::vector<Eigen::Vector3d> directions = Directions(options.sample_deg);
  const int cells = std::max(1, static_cast<int>(std::lround(90.0 / options.patch_deg)));
  check.patch_count_ = 6 * cells * cells;
  for (const Eigen::Vector3d& d : directions) {
    const Cell cell = CellOf(d, cells);
    check.patch_of_.push_back(cell.index);
    check.place_in_patch_.emplace_back(cell.u, cell.v);
  }
  const Eigen::Quaterniond quarter(Eigen::AngleAxisd(0.5 * kPi, Eigen::Vector3d::UnitZ()));
  for (const RigSensor& sensor : rig.sensors) {
    check.reduction_.push_back(PixelsOf(sensor.lens, options.sample_deg));
    auto& of_sensor = check.pixels_.emplace_back();
    for (const bool on_side : {false, true}) {
      RigSensor as = sensor;
      if (on_side) as.camera_from_sensor.rotation = sensor.camera_from_sensor.rotation * quarter;
      Pixels& pixels =
          of_sensor.emplace_back(directions.size(), Eigen::Vector2f(kNothing, kNothing));
      for (std::size_t i = 0; i < directions.size(); ++i) {
        const auto pixel = SensorPixelFromRay(as, directions[i], rig.sphere_radius_m);
        if (pixel) pixels[i] = pixel->cast<float>();
      }
    }
  }
  std::size_t shared = 0;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    int sees = 0;
    for (const auto& of_sensor : check.pixels_) sees += std::isnan(of_sensor[0][i].x()) ? 0 : 1;
    shared += sees >= 2 ? 1 : 0;
  }
  if (shared < kLeastShared) {
    return Fail(ErrorKind::kData,
                "rig: no two sensors see the same directions: expected overlaps to compare");
  }
  check.ListHypotheses();
  return check;
}

// The sensors that look to the sides, by azimuth.
std::vector<int> OrientationCheck::Ring() const {
  constexpr double kSteepest = 0.7;
  std::vector<std::pair<double, int>> ring;
  for (std::size_t i = 0; i < rig_.sensors.size(); ++i) {
    const Eigen::Vector3d axis =
        rig_.sensors[i].camera_from_sensor.rotation * Eigen::Vector3d::UnitZ();
    if (std::abs(axis.z()) > kSteepest) continue;
    ring.emplace_back(std::atan2(axis.y(), axis.x()), static_cast<int>(i));
  }
  std::sort(ring.begin(), ring.end());
  std::vector<int> sensors;
  for (const auto& [azimuth, sensor] : ring) sensors.push_back(sensor);
  return sensors;
}

void OrientationCheck::ListHypotheses() {
  const int count = static_cast<int>(rig_.sensors.size());
  std::vector<Slot> configured;
  for (int i = 0; i < count; ++i) configured.push_back({.picture = i});
  const auto add = [this](std::string what, std::vector<Slot> slots) {
    for (const Hypothesis& known : hypotheses_) {
      if (known.slots == slots) return;
    }
    // A picture fits a slot of its own size only.
    for (std::size_t i = 0; i < slots.size(); ++i) {
      const Lens& from = rig_.sensors[static_cast<std::size_t>(slots[i].picture)].lens;
      const Lens& to = rig_.sensors[i].lens;
      if (from.width() != to.width() || from.height() != to.height()) return;
    }
    std::vector<Agreement> pairs(slots.size() * slots.size());
    hypotheses_.push_back({std::move(what), std::move(slots), std::move(pairs)});
  };
  add("", configured);
  struct Turn {
    Slot as;
    const char* all;
    const char* one;
  };
  const Turn turns[] = {{{.flip_x = true}, "the pictures are stored mirrored, left for right", ""},
                        {{.flip_y = true}, "the pictures are stored mirrored, top for bottom", ""},
                        {{.flip_x = true, .flip_y = true},
                         "the pictures are stored upside down",
                         "the picture of sensor {} is stored upside down"},
                        {{.on_side = true},
                         "the rotations are 90 degrees off about the lenses' axes",
                         "the rotation of sensor {} is 90 degrees off about its lens's axis"},
                        {{.on_side = true, .flip_x = true, .flip_y = true},
                         "the rotations are 270 degrees off about the lenses' axes",
                         "the rotation of sensor {} is 270 degrees off about its lens's axis"},
                        {{.on_side = true, .flip_x = true},
                         "the pictures are stored mirrored, and the rotations are 90 degrees off",
                         ""},
                        {{.on_side = true, .flip_y = true},
                         "the pictures are stored mirrored, and the rotations are 270 degrees off",
                         ""}};
  const auto turned = [](std::vector<Slot> slots, const Slot& as) {
    for (Slot& slot : slots) {
      const int picture = slot.picture;
      slot = as;
      slot.picture = picture;
    }
    return slots;
  };
  for (const Turn& turn : turns) add(turn.all, turned(configured, turn.as));
  // Orders of the sensors.
  std::vector<std::pair<std::string, std::vector<Slot>>> orders;
  const std::vector<int> ring = Ring();
  const auto n = ring.size();
  if (n >= 3) {
    for (std::size_t turn = 0; turn < n; ++turn) {
      std::vector<Slot> reversed = configured;
      std::vector<Slot> shifted = configured;
      for (std::size_t k = 0; k < n; ++k) {
        reversed[static_cast<std::size_t>(ring[k])].picture = ring[(2 * n + turn - k) % n];
        shifted[static_cast<std::size_t>(ring[k])].picture = ring[(k + turn) % n];
      }
      // The mirror image that leaves the first sensor of the ring in its place comes first.
      const auto first = std::min_element(ring.begin(), ring.end());
      const bool keeps = reversed[static_cast<std::size_t>(*first)].picture == *first;
      orders.emplace_back("the sensors of the ring are counted the other way round", reversed);
      if (keeps && orders.size() > 1) std::swap(orders.front(), orders.back());
      orders.emplace_back(
          fmt::format("the ring is counted from another sensor on: sensor {} shows what sensor {} "
                      "should",
                      Named(rig_, shifted[static_cast<std::size_t>(*first)].picture),
                      Named(rig_, *first)),
          shifted);
    }
  }
  std::vector<Slot> from_the_end = configured;
  for (int i = 0; i < count; ++i) {
    from_the_end[static_cast<std::size_t>(i)].picture = count - 1 - i;
  }
  if (count >= 3) orders.emplace_back("the sensors are counted from the other end", from_the_end);
  for (int i = 0; i < count; ++i) {
    for (int k = i + 1; k < count; ++k) {
      std::vector<Slot> swapped = configured;
      std::swap(swapped[static_cast<std::size_t>(i)], swapped[static_cast<std::size_t>(k)]);
      orders.emplace_back(
          fmt::format("sensors {} and {} are exchanged", Named(rig_, i), Named(rig_, k)), swapped);
    }
  }
  for (auto& [what, slots] : orders) add(what, slots);
  // A single sensor.
  for (int i = 0; i < count; ++i) {
    for (const Turn& turn : turns) {
      if (std::string_view(turn.one).empty()) continue;
      std::vector<Slot> slots = configured;
      slots[static_cast<std::size_t>(i)] = turn.as;
      slots[static_cast<std::size_t>(i)].picture = i;
      add(fmt::format(fmt::runtime(turn.one), Named(rig_, i)), std::move(slots));
    }
  }
}

float OrientationCheck::ValueAt(const Reduced& pictures, int slot, const Slot& as,
                                std::size_t direction) const {
  const auto at = static_cast<std::size_t>(slot);
  const Eigen::Vector2f pixel = pixels_[at][as.on_side ? 1 : 0][direction];
  if (std::isnan(pixel.x())) return kNothing;
  const auto& lens = rig_.sensors[at].lens;
  const auto from = static_cast<std::size_t>(as.picture);
  const auto block = static_cast<float>(reduction_[from]);
  const Image<float>& picture = pictures[from];
  const float x = as.flip_x ? static_cast<float>(lens.width()) - pixel.x() : pixel.x();
  const float y = as.flip_y ? static_cast<float>(lens.height()) - pixel.y() : pixel.y();
  // Bilinear between the blocks' centres; nothing where one of them says nothing.
  const float column = x / block - 0.5F;
  const float row = y / block - 0.5F;
  const int left = static_cast<int>(std::floor(column));
  const int top = static_cast<int>(std::floor(row));
  if (left < 0 || top < 0 || left + 1 >= picture.width() || top + 1 >= picture.height()) {
    return kNothing;
  }
  const float dx = column - static_cast<float>(left);
  const float dy = row - static_cast<float>(top);
  const float upper = picture.at(left, top) * (1.0F - dx) + picture.at(left + 1, top) * dx;
  const float lower = picture.at(left, top + 1) * (1.0F - dx) + picture.at(left + 1, top + 1) * dx;
  return upper * (1.0F - dy) + lower * dy;
}

std::vector<OrientationCheck::Agreement> OrientationCheck::Compare(
    const Reduced& pictures, const Hypothesis& hypothesis) const {
  const int count = static_cast<int>(rig_.sensors.size());
  const std::size_t directions = patch_of_.size();
  std::vector<std::vector<float>> values;
  for (int i = 0; i < count; ++i) {
    auto& of_slot = values.emplace_back(directions, kNothing);
    const Slot& as = hypothesis.slots[static_cast<std::size_t>(i)];
    for (std::size_t d = 0; d < directions; ++d) of_slot[d] = ValueAt(pictures, i, as, d);
  }
  std::vector<Agreement> pairs(hypothesis.pairs.size());
  std::vector<Sums> patches;
  for (int i = 0; i < count; ++i) {
    for (int k = i + 1; k < count; ++k) {
      patches.assign(static_cast<std::size_t>(patch_count_), Sums::Zero());
      for (std::size_t d = 0; d < directions; ++d) {
        const float a = values[static_cast<std::size_t>(i)][d];
        const float b = values[static_cast<std::size_t>(k)][d];
        if (std::isnan(a) || std::isnan(b)) continue;
        Eigen::Matrix<double, 5, 1> row;
        row << 1.0, place_in_patch_[d].cast<double>(), a, b;
        patches[static_cast<std::size_t>(patch_of_[d])].noalias() += row * row.transpose();
      }
      for (const Sums& patch : patches) {
        if (patch(0, 0) < kLeastSamplesOfAPatch) continue;
        const Eigen::Matrix2d rest = WithoutPlane(patch);
        const double aa = std::max(0.0, rest(0, 0));
        const double bb = std::max(0.0, rest(1, 1));
        const double ab = rest(0, 1);
        if (std::max(aa, bb) < options_.texture * options_.texture) continue;
        constexpr double kFloor = kNoiseFloor * kNoiseFloor;
        pairs[static_cast<std::size_t>(i * count + k)].Add(
            {ab / std::sqrt((aa + kFloor) * (bb + kFloor)), 1});
      }
    }
  }
  return pairs;
}

template <typename Value>
Result<bool> OrientationCheck::AddValues(ImageView<const Value> stack) {
  int height = 0;
  const int width = rig_.sensors.front().lens.width();
  for (const RigSensor& sensor : rig_.sensors) height += sensor.lens.height();
  if (stack.width() != width || stack.height() != height) {
    return Fail(ErrorKind::kData, "frame of {}x{}: expected {}x{}, the rig's sensors stacked",
                stack.width(), stack.height(), width, height);
  }
  Reduced pictures;
  int top = 0;
  for (std::size_t i = 0; i < rig_.sensors.size(); ++i) {
    const int rows = rig_.sensors[i].lens.height();
    pictures.push_back(Reduce<Value>(stack.Crop(0, top, width, rows), reduction_[i]));
    top += rows;
  }
  const std::vector<Agreement> configured = Compare(pictures, hypotheses_.front());
  Agreement all;
  for (const Agreement& pair : configured) all.Add(pair);
  if (all.patches < options_.least_patches) return false;
  const auto add = [](const std::vector<Agreement>& pairs, Hypothesis* hypothesis) {
    for (std::size_t i = 0; i < pairs.size(); ++i) hypothesis->pairs[i].Add(pairs[i]);
  };
  add(configured, &hypotheses_.front());
  for (std::size_t i = 1; i < hypotheses_.size(); ++i) {
    add(Compare(pictures, hypotheses_[i]), &hypotheses_[i]);
  }
  ++frames_;
  return true;
}

Result<bool> OrientationCheck::Add(ImageView<const std::uint8_t> stack) { return AddValues(stack); }
Result<bool> OrientationCheck::Add(ImageView<const std::uint16_t> stack) {
  return AddValues(stack);
}

OrientationAlternative OrientationCheck::Judge(const Hypothesis& hypothesis) const {
  const Hypothesis& configured = hypotheses_.front();
  const std::size_t count = hypothesis.slots.size();
  Agreement all;
  Agreement there;
  Agreement configured_there;
  for (std::size_t pair = 0; pair < hypothesis.pairs.size(); ++pair) {
    all.Add(hypothesis.pairs[pair]);
    const std::size_t first = pair / count;
    const std::size_t second = pair % count;
    if (hypothesis.slots[first] == configured.slots[first] &&
        hypothesis.slots[second] == configured.slots[second]) {
      continue;
    }
    there.Add(hypothesis.pairs[pair]);
    configured_there.Add(configured.pairs[pair]);
  }
  const int least = options_.least_compared;
  OrientationAlternative judged{hypothesis.what, all.mean(), all.patches, 0.0, 0.0};
  // What hardly anything is seen by says nothing.
  if (there.patches >= least && configured_there.patches >= least) {
    judged.where_it_differs = there.mean();
    judged.configured_there = configured_there.mean();
  }
  return judged;
}

OrientationReport OrientationCheck::Report() const {
  OrientationReport report;
  report.frames = frames_;
  report.configured = Judge(hypotheses_.front());
  if (frames_ == 0) return report;
  std::vector<OrientationAlternative> better;
  double best_agreement = -1.0;
  for (std::size_t i = 1; i < hypotheses_.size(); ++i) {
    OrientationAlternative each = Judge(hypotheses_[i]);
    if (each.patches >= options_.least_compared)
      best_agreement = std::max(best_agreement, each.agreement);
    if (each.agreement > report.configured.agreement &&
        each.where_it_differs >= options_.contradicts &&
        each.where_it_differs >= each.configured_there + options_.clearly_better) {
      better.push_back(std::move(each));
    }
  }
  std::stable_sort(better.begin(), better.end(),
                   [](const auto& a, const auto& b) { return a.agreement > b.agreement; });
  for (OrientationAlternative& each : better) {
    if (each.agreement < better.front().agreement - options_.about_equal) break;
    const auto told = [&](const auto& known) { return known.what == each.what; };
    if (std::none_of(report.best.begin(), report.best.end(), told)) report.best.push_back(each);
  }
  if (!report.best.empty()) {
    report.verdict = OrientationVerdict::kContradicted;
  } else if (report.configured.agreement >= options_.agrees &&
             best_agreement <= report.configured.agreement + options_.about_equal) {
    report.verdict = OrientationVerdict::kAgrees;
  }
  return report;
}

}  // namespace omnihdr
