#include "core/session/rig_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/session/response_json.h"
#include "core/session/toml.h"

namespace omnihdr {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kRadiansPerFovDegree = kPi / 360.0;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::int64_t kMaxSide = 65536;
constexpr std::int64_t kMaxGridSide = 4096;
constexpr std::size_t kMaxSensors = 64;

std::optional<double> AsNumber(const TomlValue& value) {
  if (value.type == TomlValue::Type::kFloat) return value.real;
  if (value.type == TomlValue::Type::kInteger) return static_cast<double>(value.integer);
  return std::nullopt;
}

// The keys of one table of the file; reading a key marks it as known.
class TableReader {
 public:
  TableReader(const TomlDocument& document, std::string file, std::string prefix, int line)
      : file_(std::move(file)), prefix_(std::move(prefix)), line_(line) {
    for (const TomlEntry& entry : document.entries) {
      if (!entry.key.starts_with(prefix_)) continue;
      keys_.emplace(entry.key.substr(prefix_.size()), Item{&entry, false});
    }
  }

  tl::unexpected<Error> Wrong(std::string_view key, std::string_view expected) const {
    const auto found = keys_.find(std::string(key));
    if (found == keys_.end()) {
      return Fail(ErrorKind::kData, "{}:{}: {}{}: missing, expected {}", file_, line_, prefix_, key,
                  expected);
    }
    const TomlEntry& entry = *found->second.entry;
    return Fail(ErrorKind::kData, "{}:{}: {}: {}, expected {}", file_, entry.line, entry.key,
                entry.value ? ShownToml(*entry.value) : std::string("a section"), expected);
  }

  // A message that starts with the name of one of the keys, put at that key's line.
  tl::unexpected<Error> WrongAsTold(const std::string& message) const {
    const std::string key = message.substr(0, message.find_first_of(" :"));
    const auto found = keys_.find(key);
    const int line = found == keys_.end() ? line_ : found->second.entry->line;
    return Fail(ErrorKind::kData, "{}:{}: {}{}", file_, line, prefix_, message);
  }

  bool Has(std::string_view key) const { return keys_.count(std::string(key)) > 0; }

  const TomlValue* Value(std::string_view key) {
    const auto found = keys_.find(std::string(key));
    if (found == keys_.end()) return nullptr;
    found->second.known = true;
    return found->second.entry->value ? &*found->second.entry->value : nullptr;
  }

  // A heading below this table, [sensor.name]; its line, or nothing.
  std::optional<int> Section(std::string_view key) {
    const auto found = keys_.find(std::string(key));
    if (found == keys_.end() || found->second.entry->value) return std::nullopt;
    found->second.known = true;
    const std::string below = std::string(key) + ".";
    for (auto& [name, item] : keys_) {
      if (name.starts_with(below)) item.known = true;
    }
    return found->second.entry->line;
  }

  Result<double> Number(std::string_view key, double low, double high, std::string_view expected) {
    const TomlValue* value = Value(key);
    const std::optional<double> number = value != nullptr ? AsNumber(*value) : std::nullopt;
    if (!number || !(*number >= low && *number <= high)) return Wrong(key, expected);
    return *number;
  }

  Result<double> NumberOr(std::string_view key, double fallback, double low, double high,
                          std::string_view expected) {
    if (!Has(key)) return fallback;
    return Number(key, low, high, expected);
  }

  Result<int> Whole(std::string_view key, std::int64_t low, std::int64_t high,
                    std::string_view expected) {
    const TomlValue* value = Value(key);
    if (value == nullptr || value->type != TomlValue::Type::kInteger || value->integer < low ||
        value->integer > high) {
      return Wrong(key, expected);
    }
    return static_cast<int>(value->integer);
  }

  Result<std::string> Text(std::string_view key, std::size_t longest, std::string_view expected) {
    const TomlValue* value = Value(key);
    if (value == nullptr || value->type != TomlValue::Type::kString ||
        value->text.size() > longest) {
      return Wrong(key, expected);
    }
    return value->text;
  }

  Result<std::string> TextOr(std::string_view key, std::size_t longest, std::string_view expected) {
    if (!Has(key)) return std::string();
    return Text(key, longest, expected);
  }

  template <std::size_t N>
  Result<std::array<double, N>> Numbers(std::string_view key, std::string_view expected) {
    const TomlValue* value = Value(key);
    if (value == nullptr || value->type != TomlValue::Type::kArray || value->items.size() != N) {
      return Wrong(key, expected);
    }
    std::array<double, N> numbers{};
    for (std::size_t i = 0; i < N; ++i) {
      const std::optional<double> number = AsNumber(value->items[i]);
      if (!number || !std::isfinite(*number)) return Wrong(key, expected);
      numbers[i] = *number;
    }
    return numbers;
  }

  // The first key nobody asked for.
  Status NoOthers(std::string_view known) const {
    const TomlEntry* first = nullptr;
    for (const auto& [name, item] : keys_) {
      if (item.known || (first != nullptr && first->line <= item.entry->line)) continue;
      first = item.entry;
    }
    if (first == nullptr) return {};
    return Fail(ErrorKind::kData, "{}:{}: {}: {}, expected one of {}", file_, first->line,
                first->key, first->value ? ShownToml(*first->value) : std::string("a section"),
                known);
  }

 private:
  struct Item {
    const TomlEntry* entry = nullptr;
    bool known = false;
  };
  std::string file_;
  std::string prefix_;
  int line_;
  std::map<std::string, Item> keys_;
};

Result<LensGrid> ReadGrid(const TomlDocument& document, const std::string& file,
                          const std::string& prefix, TableReader& sensor, std::string_view name) {
  const std::optional<int> line = sensor.Section(name);
  if (!line) {
    return sensor.Wrong(name, fmt::format("a table [sensor.{}] with lens = \"grid\"", name));
  }
  TableReader table(document, file, fmt::format("{}{}.", prefix, name), *line);
  LensGrid grid;
  OMNIHDR_ASSIGN(grid.columns, table.Whole("columns", 2, kMaxGridSide, "2 to 4096 columns"));
  OMNIHDR_ASSIGN(grid.rows, table.Whole("rows", 2, kMaxGridSide, "2 to 4096 rows"));
  OMNIHDR_ASSIGN(const auto step, (table.Numbers<2>("step",
                                                    "[x, y], the nodes' distance in "
                                                    "pixels")));
  grid.step_x = step[0];
  grid.step_y = step[1];
  const std::size_t values =
      2 * static_cast<std::size_t>(grid.columns) * static_cast<std::size_t>(grid.rows);
  const std::string expected = fmt::format("{} numbers or nan: x, y of {}x{} nodes, row by row",
                                           values, grid.columns, grid.rows);
  const TomlValue* points = table.Value("points");
  if (points == nullptr || points->type != TomlValue::Type::kArray) {
    return table.Wrong("points", expected);
  }
  if (points->items.size() != values) {
    return table.WrongAsTold(
        fmt::format("points: {} values, expected {}", points->items.size(), expected));
  }
  grid.points.reserve(values / 2);
  for (std::size_t i = 0; i < values; i += 2) {
    const std::optional<double> x = AsNumber(points->items[i]);
    const std::optional<double> y = AsNumber(points->items[i + 1]);
    if (!x || !y || std::abs(*x) > 1e6 || std::abs(*y) > 1e6) {
      return table.WrongAsTold(fmt::format("points: node {}: [{}, {}], expected {}", i / 2,
                                           ShownToml(points->items[i]),
                                           ShownToml(points->items[i + 1]), expected));
    }
    grid.points.emplace_back(static_cast<float>(*x), static_cast<float>(*y));
  }
  OMNIHDR_TRY(table.NoOthers("columns, rows, step, points"));
  return grid;
}

Result<Lens> ReadLens(const TomlDocument& document, const std::string& file,
                      const std::string& prefix, TableReader& sensor) {
  constexpr std::string_view kSize = "[columns, rows], 1 to 65536 pixels each";
  OMNIHDR_ASSIGN(const auto size, sensor.Numbers<2>("size", kSize));
  for (const double side : size) {
    if (side < 1.0 || side > static_cast<double>(kMaxSide) || side != std::floor(side)) {
      return sensor.Wrong("size", kSize);
    }
  }
  const int width = static_cast<int>(size[0]);
  const int height = static_cast<int>(size[1]);
  constexpr std::string_view kKinds = "\"pinhole\", \"fisheye\" or \"grid\"";
  OMNIHDR_ASSIGN(const std::string name, sensor.Text("lens", 32, kKinds));
  const std::optional<LensKind> kind = LensKindFromString(name);
  if (!kind) return sensor.Wrong("lens", kKinds);
  OMNIHDR_ASSIGN(const auto focal, sensor.Numbers<2>("focal", "[x, y], positive pixels"));
  OMNIHDR_ASSIGN(const auto centre, sensor.Numbers<2>("centre", "[x, y] in pixels"));
  const Eigen::Vector2d f(focal[0], focal[1]);
  const Eigen::Vector2d c(centre[0], centre[1]);
  Result<Lens> lens = Fail(ErrorKind::kSoftware, "no lens");
  if (*kind == LensKind::kGrid) {
    OMNIHDR_ASSIGN(LensGrid raw, ReadGrid(document, file, prefix, sensor, "raw_from_rectified"));
    OMNIHDR_ASSIGN(LensGrid back, ReadGrid(document, file, prefix, sensor, "rectified_from_raw"));
    lens = Lens::Grid(width, height, f, c, std::move(raw), std::move(back));
  } else {
    OMNIHDR_ASSIGN(
        const auto distortion,
        sensor.Numbers<5>("distortion", *kind == LensKind::kPinhole ? "[k1, k2, p1, p2, k3]"
                                                                    : "[k1, k2, k3, k4, k5]"));
    OMNIHDR_ASSIGN(const double fov,
                   sensor.Number("fov_deg", 0.0, 360.0, "the full field of view in degrees"));
    const double max_angle = fov * kRadiansPerFovDegree;
    lens = *kind == LensKind::kPinhole ? Lens::Pinhole(width, height, f, c, distortion, max_angle)
                                       : Lens::Fisheye(width, height, f, c, distortion, max_angle);
  }
  if (!lens) return sensor.WrongAsTold(lens.error().message);
  return lens;
}

bool IsRelativeInside(const std::string& file) {
  const std::filesystem::path path(file);
  if (path.is_absolute() || file.find('\0') != std::string::npos) return false;
  return std::none_of(path.begin(), path.end(),
                      [](const std::filesystem::path& part) { return part == ".."; });
}

Result<RigSensor> ReadSensor(const TomlDocument& document, const std::string& file,
                             const std::string& prefix, int line, const Rig& before) {
  TableReader table(document, file, prefix, line);
  RigSensor sensor;
  OMNIHDR_ASSIGN(sensor.name, table.Text("name", 64, "a name of 1 to 64 bytes"));
  if (sensor.name.empty()) return table.Wrong("name", "a name of 1 to 64 bytes");
  for (const RigSensor& other : before.sensors) {
    if (other.name == sensor.name) return table.Wrong("name", "another name than before");
  }
  OMNIHDR_ASSIGN(sensor.lens, ReadLens(document, file, prefix, table));
  constexpr std::string_view kRotation =
      "[w, x, y, z], a quaternion of length 1 that turns lens axes (X right, Y down, Z out) into "
      "the rig's (X forward, Y left, Z up)";
  OMNIHDR_ASSIGN(const auto q, table.Numbers<4>("rotation", kRotation));
  Eigen::Quaterniond& rotation = sensor.camera_from_sensor.rotation;
  rotation = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  const double norm = rotation.norm();
  if (!(std::abs(norm - 1.0) < 1e-3)) return table.Wrong("rotation", kRotation);
  // Rounded by hand: made exact; else left alone, so that a file is read as it was written.
  if (std::abs(norm - 1.0) > 1e-12) rotation.normalize();
  OMNIHDR_ASSIGN(const auto t, table.Numbers<3>("translation", "[x, y, z] in metres"));
  sensor.camera_from_sensor.translation = {t[0], t[1], t[2]};
  if (table.Has("bayer")) {
    constexpr std::string_view kOrders =
        "\"RGGB\", \"GRBG\", \"GBRG\", \"BGGR\", or \"none\" for finished pictures";
    OMNIHDR_ASSIGN(const std::string name, table.Text("bayer", 16, kOrders));
    const std::optional<BayerOrder> order = BayerOrderFromString(name);
    if (!order) return table.Wrong("bayer", kOrders);
    sensor.bayer = *order;
  }
  if (table.Has("gain")) {
    OMNIHDR_ASSIGN(sensor.gain, table.Numbers<3>("gain", "[r, g, b], each 1e-6 to 1e6"));
  }
  if (table.Has("vignetting")) {
    OMNIHDR_ASSIGN(sensor.vignetting.coefficients,
                   table.Numbers<3>("vignetting", "three coefficients of ρ², ρ⁴, ρ⁶"));
  }
  constexpr std::string_view kMask =
      "a picture's file below the rig file's folder, by a relative path";
  OMNIHDR_ASSIGN(sensor.mask_file, table.TextOr("mask", 4096, kMask));
  if (!IsRelativeInside(sensor.mask_file)) return table.Wrong("mask", kMask);
  OMNIHDR_ASSIGN(sensor.response_json,
                 table.TextOr("response", 1 << 20, "the JSON object of session.json's response"));
  if (!sensor.response_json.empty()) {
    const Result<Response> response = ParseResponse(sensor.response_json, "response");
    if (!response) return table.WrongAsTold(response.error().message);
  }
  OMNIHDR_TRY(
      table.NoOthers("name, size, lens, focal, centre, distortion, fov_deg, rotation, translation, "
                     "bayer, gain, vignetting, mask, response"));
  if (const Status ok = sensor.Validate(); !ok) return table.WrongAsTold(ok.error().message);
  return sensor;
}

// Degrees that read back as exactly this angle where there are such, the roundest of them.
std::string FovText(double max_angle) {
  const double degrees = max_angle / kRadiansPerFovDegree;
  const auto same = [&](double value) { return value * kRadiansPerFovDegree == max_angle; };
  for (const double scale : {1.0, 1e3, 1e6, 1e9}) {
    const double rounded = std::round(degrees * scale) / scale;
    if (same(rounded)) return TomlText(rounded);
  }
  for (const double value :
       {degrees, std::nextafter(degrees, 0.0), std::nextafter(degrees, 360.0)}) {
    if (same(value)) return TomlText(value);
  }
  return TomlText(degrees);
}

template <typename Values>
std::string List(const Values& values) {
  std::string text = "[";
  for (const double value : values) {
    if (text.size() > 1) text += ", ";
    text += TomlText(value);
  }
  return text + "]";
}

void AppendGrid(std::string& text, std::string_view name, const LensGrid& grid) {
  text += fmt::format("  [sensor.{}]\n  columns = {}\n  rows = {}\n  step = {}\n  points = [", name,
                      grid.columns, grid.rows, List(std::array{grid.step_x, grid.step_y}));
  std::size_t column = 0;
  for (const Eigen::Vector2f& p : grid.points) {
    text += column++ % 8 == 0 ? "\n    " : " ";
    text += std::isfinite(p.x()) && std::isfinite(p.y())
                ? fmt::format("{}, {},", p.x() + 0.0F, p.y() + 0.0F)
                : std::string("nan, nan,");
  }
  text += "\n  ]\n";
}

void AppendSensor(std::string& text, const RigSensor& sensor) {
  const Lens& lens = sensor.lens;
  const Eigen::Quaterniond& q = sensor.camera_from_sensor.rotation;
  const Eigen::Vector3d& t = sensor.camera_from_sensor.translation;
  text += fmt::format("\n[[sensor]]\nname = {}\nsize = [{}, {}]\n", TomlText(sensor.name),
                      lens.width(), lens.height());
  if (sensor.bayer != BayerOrder::kNone) {
    text += fmt::format("bayer = \"{}\"\n", ToString(sensor.bayer));
  }
  text += fmt::format("lens = \"{}\"\nfocal = {}\ncentre = {}\n", ToString(lens.kind()),
                      List(std::array{lens.focal().x(), lens.focal().y()}),
                      List(std::array{lens.centre().x(), lens.centre().y()}));
  if (lens.kind() != LensKind::kGrid) {
    text += fmt::format("distortion = {}\nfov_deg = {}\n", List(lens.distortion()),
                        FovText(lens.max_angle()));
  }
  text +=
      fmt::format("rotation = {}\ntranslation = {}\n", List(std::array{q.w(), q.x(), q.y(), q.z()}),
                  List(std::array{t.x(), t.y(), t.z()}));
  if (sensor.gain != std::array{1.0, 1.0, 1.0}) {
    text += fmt::format("gain = {}\n", List(sensor.gain));
  }
  if (sensor.vignetting.coefficients != std::array{0.0, 0.0, 0.0}) {
    text += fmt::format("vignetting = {}\n", List(sensor.vignetting.coefficients));
  }
  if (!sensor.mask_file.empty()) text += fmt::format("mask = {}\n", TomlText(sensor.mask_file));
  if (!sensor.response_json.empty()) {
    text += fmt::format("response = {}\n", TomlText(sensor.response_json));
  }
  if (lens.kind() == LensKind::kGrid) {
    AppendGrid(text, "raw_from_rectified", *lens.raw_from_rectified());
    AppendGrid(text, "rectified_from_raw", *lens.rectified_from_raw());
  }
}

}  // namespace

Result<Rig> ParseRig(std::string_view text, const std::string& name) {
  const TomlDocument document = ParseToml(text, kMaxRigBytes);
  if (!document.error.empty()) {
    return Fail(ErrorKind::kData, "{}:{}: {}", name, document.error_line, document.error);
  }
  // The top level's own keys; those of the sensors are read with their own table.
  TomlDocument top;
  std::vector<std::pair<std::string, int>> sensors;
  for (const TomlEntry& entry : document.entries) {
    const std::string heading = fmt::format("sensor[{}]", sensors.size());
    if (entry.key == heading && !entry.value) {
      sensors.emplace_back(heading, entry.line);
    } else if (!entry.key.starts_with("sensor[")) {
      top.entries.push_back(entry);
    }
  }
  TableReader table(top, name, "", 1);
  if (sensors.size() > kMaxSensors) {
    return Fail(ErrorKind::kData, "{}:{}: sensor[{}]: {} sensors, expected at most {}", name,
                sensors[kMaxSensors].second, kMaxSensors, sensors.size(), kMaxSensors);
  }
  constexpr std::string_view kFormat = "\"omnihdr-rig\"";
  OMNIHDR_ASSIGN(const std::string format, table.Text("format", 64, kFormat));
  if (format != "omnihdr-rig") return table.Wrong("format", kFormat);
  OMNIHDR_TRY(table.Whole("version", 1, 1, "1"));
  Rig rig;
  OMNIHDR_ASSIGN(rig.model, table.TextOr("model", 256, "a text of at most 256 bytes"));
  OMNIHDR_ASSIGN(rig.serial, table.TextOr("serial", 256, "a text of at most 256 bytes"));
  OMNIHDR_ASSIGN(rig.sphere_radius_m,
                 table.NumberOr("sphere_radius_m", rig.sphere_radius_m, 1e-3, kInfinity,
                                "metres, at least 0.001; inf = directions alone"));
  OMNIHDR_ASSIGN(rig.blend_width_deg, table.NumberOr("blend_width_deg", rig.blend_width_deg, 0.0,
                                                     90.0, "degrees in [0, 90]"));
  if (sensors.empty()) {
    return table.Wrong("sensor", "a table [[sensor]] for each sensor, in the order of the frame");
  }
  OMNIHDR_TRY(table.NoOthers(
      "format, version, model, serial, sphere_radius_m, blend_width_deg, [[sensor]]"));
  for (const auto& [heading, line] : sensors) {
    OMNIHDR_ASSIGN(RigSensor sensor, ReadSensor(document, name, heading + ".", line, rig));
    rig.sensors.push_back(std::move(sensor));
  }
  if (const Status ok = rig.Validate(); !ok) return table.WrongAsTold(ok.error().message);
  return rig;
}

Result<Rig> ReadRig(const std::filesystem::path& path) {
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(path, kMaxRigBytes));
  return ParseRig(text, path.string());
}

std::string FormatRig(const Rig& rig, std::string_view comment) {
  std::string text;
  while (!comment.empty()) {
    const std::size_t end = std::min(comment.find('\n'), comment.size());
    text += end == 0 ? std::string("#\n") : fmt::format("# {}\n", comment.substr(0, end));
    comment.remove_prefix(std::min(end + 1, comment.size()));
  }
  text += fmt::format(
      "format = \"omnihdr-rig\"\nversion = 1\nmodel = {}\nserial = {}\nsphere_radius_m = {}\n"
      "blend_width_deg = {}\n",
      TomlText(rig.model), TomlText(rig.serial), TomlText(rig.sphere_radius_m),
      TomlText(rig.blend_width_deg));
  for (const RigSensor& sensor : rig.sensors) AppendSensor(text, sensor);
  return text;
}

}  // namespace omnihdr
