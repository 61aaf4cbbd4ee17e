#include "core/session/rig_import.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

namespace omnihdr {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::size_t kMaxTextBytes = std::size_t{1} << 20;
constexpr int kLadybugSensors = 6;
constexpr int kMaxVuzeLenses = 64;
constexpr int kCsvWidth = 4928;
constexpr int kCsvHeight = 4096;
constexpr double kRectifiedFovDeg = 110.0;
constexpr double kFisheyeFovDeg = 180.0;

struct Line {
  int number = 0;
  std::string_view text;
};

std::vector<Line> LinesOf(std::string_view text) {
  std::vector<Line> lines;
  int number = 0;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ' || line.back() == '\t')) {
      line.remove_suffix(1);
    }
    lines.push_back({++number, line});
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

std::vector<std::string_view> Split(std::string_view line, std::string_view separators) {
  std::vector<std::string_view> parts;
  while (true) {
    const std::size_t begin = line.find_first_not_of(separators);
    if (begin == std::string_view::npos) return parts;
    const std::size_t end = std::min(line.find_first_of(separators, begin), line.size());
    parts.push_back(line.substr(begin, end - begin));
    line.remove_prefix(end);
  }
}

std::optional<double> NumberOf(std::string_view text) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  // OpenCV writes whole numbers as "1."; from_chars takes the point too.
  if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

std::string Shown(std::string_view text) {
  std::string shown;
  for (const char c : text.substr(0, 60)) {
    const auto byte = static_cast<unsigned char>(c);
    shown += byte >= 0x20 && byte < 0x7F ? c : '?';
  }
  return text.size() > 60 ? shown + "..." : shown;
}

Eigen::Matrix3d LadybugRotation(double rx, double ry, double rz) {
  using Eigen::AngleAxisd;
  return (AngleAxisd(rz, Eigen::Vector3d::UnitZ()) * AngleAxisd(ry, Eigen::Vector3d::UnitY()) *
          AngleAxisd(rx, Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

// Six extrinsic numbers, focal length, centre; where each came from.
struct LadybugSensor {
  std::array<double, 6> extrinsics{};
  double focal = 0.0;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
};

Result<Rig> LadybugRig(const std::array<LadybugSensor, kLadybugSensors>& sensors, int width,
                       int height, const RigImportOptions& options, const std::string& name) {
  Rig rig;
  const double fov = options.fov_deg > 0.0 ? options.fov_deg : kRectifiedFovDeg;
  for (int i = 0; i < kLadybugSensors; ++i) {
    const LadybugSensor& from = sensors[static_cast<std::size_t>(i)];
    RigSensor sensor;
    sensor.name = fmt::format("{}", i);
    Result<Lens> lens = Lens::Pinhole(width, height, Eigen::Vector2d::Constant(from.focal),
                                      from.centre + Eigen::Vector2d::Constant(0.5),
                                      std::array<double, 5>{}, 0.5 * fov * kDegree);
    if (!lens) {
      return Fail(ErrorKind::kData, "{}: sensor {}: {}", name, i, lens.error().message);
    }
    sensor.lens = *std::move(lens);
    const auto& e = from.extrinsics;
    sensor.camera_from_sensor.rotation =
        Eigen::Quaterniond(LadybugRotation(e[0], e[1], e[2])).normalized();
    sensor.camera_from_sensor.translation = {e[3], e[4], e[5]};
    rig.sensors.push_back(std::move(sensor));
  }
  OMNIHDR_TRY(rig.Validate().Context(name));
  return rig;
}

// Rows "Cam_id and `columns` numbers" below the heading of one of the two tables.
Status ReadCsvTable(const RigText& file, std::size_t columns,
                    std::array<std::vector<double>, kLadybugSensors>& rows) {
  for (const Line& line : LinesOf(file.text)) {
    if (line.number == 1 || line.text.empty()) continue;
    const std::vector<std::string_view> parts = Split(line.text, "\t,; ");
    if (parts.empty()) continue;
    const std::string where = fmt::format("{}:{}", file.name, line.number);
    if (parts.size() != columns + 1) {
      return Fail(ErrorKind::kData, "{}: {} columns, expected {}", where, parts.size(),
                  columns + 1);
    }
    const std::optional<double> id = NumberOf(parts[0]);
    if (!id || *id < 0 || *id >= kLadybugSensors || *id != std::floor(*id)) {
      return Fail(ErrorKind::kData, "{}: Cam_id: {}, expected 0 to 5", where, Shown(parts[0]));
    }
    std::vector<double>& row = rows[static_cast<std::size_t>(*id)];
    if (!row.empty()) {
      return Fail(ErrorKind::kData, "{}: Cam_id: {} twice, expected each once", where,
                  Shown(parts[0]));
    }
    for (std::size_t c = 1; c <= columns; ++c) {
      const std::optional<double> value = NumberOf(parts[c]);
      if (!value) {
        return Fail(ErrorKind::kData, "{}: column {}: {}, expected a number", where, c + 1,
                    Shown(parts[c]));
      }
      row.push_back(*value);
    }
  }
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (rows[i].empty()) {
      return Fail(ErrorKind::kData, "{}: no row with Cam_id {}, expected 0 to 5", file.name, i);
    }
  }
  return {};
}

bool StartsWithColumns(std::string_view text, std::initializer_list<std::string_view> columns) {
  const std::vector<std::string_view> parts =
      Split(text.substr(0, text.find_first_of("\r\n")), "\t,; ");
  return std::equal(parts.begin(), parts.end(), columns.begin(), columns.end());
}

bool IsInteriorTable(std::string_view text) {
  return StartsWithColumns(text, {"Cam_id", "F[px]", "PPx[px]", "PPy[px]"});
}

bool IsExteriorTable(std::string_view text) {
  return StartsWithColumns(text,
                           {"Cam_id", "Rx[rad]", "Ry[rad]", "Rz[rad]", "Tx[m]", "Ty[m]", "Tz[m]"});
}

Result<Rig> ImportLadybugCsv(const std::vector<RigText>& files, const RigImportOptions& options) {
  const RigText* interior = nullptr;
  const RigText* exterior = nullptr;
  for (const RigText& file : files) {
    if (IsInteriorTable(file.text)) {
      interior = &file;
    } else if (IsExteriorTable(file.text)) {
      exterior = &file;
    } else {
      return Fail(ErrorKind::kData,
                  "{}:1: {}, expected the columns Cam_id F[px] PPx[px] PPy[px] or Cam_id Rx[rad] "
                  "Ry[rad] Rz[rad] Tx[m] Ty[m] Tz[m]",
                  file.name, Shown(file.text.substr(0, file.text.find('\n'))));
    }
  }
  if (interior == nullptr || exterior == nullptr || files.size() != 2) {
    return Fail(ErrorKind::kUsage,
                "{}: expected two files, the interior (F, PPx, PPy) and the exterior (Rx … Tz) "
                "orientation",
                files.front().name);
  }
  std::array<std::vector<double>, kLadybugSensors> in;
  std::array<std::vector<double>, kLadybugSensors> ex;
  OMNIHDR_TRY(ReadCsvTable(*interior, 3, in));
  OMNIHDR_TRY(ReadCsvTable(*exterior, 6, ex));
  std::array<LadybugSensor, kLadybugSensors> sensors;
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    sensors[i].focal = in[i][0];
    sensors[i].centre = {in[i][1], in[i][2]};
    std::copy(ex[i].begin(), ex[i].end(), sensors[i].extrinsics.begin());
  }
  return LadybugRig(sensors, options.width > 0 ? options.width : kCsvWidth,
                    options.height > 0 ? options.height : kCsvHeight, options, interior->name);
}

Result<Rig> ImportLadybugText(const std::vector<RigText>& files, const RigImportOptions& options) {
  const RigText& file = files.front();
  if (files.size() != 1) {
    return Fail(ErrorKind::kUsage, "{}: expected one file of this kind", files[1].name);
  }
  if (options.width < 1 || options.height < 1) {
    return Fail(ErrorKind::kUsage,
                "{}: the text does not tell the size of the rectified pictures, expected it to be "
                "given (width and height)",
                file.name);
  }
  static constexpr std::array<std::string_view, 9> kFields = {
      "rotX",   "rotY",     "rotZ",          "transX",       "transY",
      "transZ", "FocalLen", "CameraCenterX", "CameraCenterY"};
  static constexpr std::array<std::string_view, 4> kUnused = {"camera_serialBase", "rotation_dRx",
                                                              "rotation_dRy", "rotation_dRz"};
  std::array<std::array<std::optional<double>, kFields.size()>, kLadybugSensors> values;
  std::string model;
  std::string serial;
  for (const Line& line : LinesOf(file.text)) {
    if (line.text.empty() || line.text.front() == '#') continue;
    const std::string where = fmt::format("{}:{}", file.name, line.number);
    const std::size_t equals = line.text.find('=');
    if (equals == std::string_view::npos) {
      return Fail(ErrorKind::kData, "{}: {}, expected key=value", where, Shown(line.text));
    }
    const std::string_view key = line.text.substr(0, equals);
    const std::string_view value = line.text.substr(equals + 1);
    if (key == "camera_model" || key == "camera_serialHead") {
      (key == "camera_model" ? model : serial) = Shown(value);
      continue;
    }
    if (std::find(kUnused.begin(), kUnused.end(), key) != kUnused.end()) continue;
    const auto field = std::find_if(kFields.begin(), kFields.end(), [&](std::string_view name) {
      return key.size() == name.size() + 8 && key.starts_with("camera") && key[7] == '_' &&
             key.ends_with(name) && key[6] >= '0' && key[6] < '0' + kLadybugSensors;
    });
    if (field == kFields.end()) {
      return Fail(ErrorKind::kData,
                  "{}: {}: not a key this import knows, expected cameraN_rotX … cameraN_transZ, "
                  "cameraN_FocalLen, cameraN_CameraCenterX, cameraN_CameraCenterY with N 0 to 5",
                  where, Shown(key));
    }
    std::optional<double>& to = values[static_cast<std::size_t>(key[6] - '0')]
                                      [static_cast<std::size_t>(field - kFields.begin())];
    if (to) return Fail(ErrorKind::kData, "{}: {}: twice, expected once", where, key);
    to = NumberOf(value);
    if (!to) {
      return Fail(ErrorKind::kData, "{}: {}: {}, expected a number", where, key, Shown(value));
    }
  }
  std::array<LadybugSensor, kLadybugSensors> sensors;
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    for (std::size_t k = 0; k < kFields.size(); ++k) {
      if (!values[i][k]) {
        return Fail(ErrorKind::kData, "{}: camera{}_{}: missing, expected a number", file.name, i,
                    kFields[k]);
      }
      if (k < 6) sensors[i].extrinsics[k] = *values[i][k];
    }
    sensors[i].focal = *values[i][6];
    sensors[i].centre = {*values[i][7], *values[i][8]};
  }
  OMNIHDR_ASSIGN(Rig rig, LadybugRig(sensors, options.width, options.height, options, file.name));
  rig.model = model;
  rig.serial = serial;
  return rig;
}

// The part of YAML that OpenCV writes: indented "key:", "key: value", "key: [ list ]" over several
// lines. Keyed by the dotted path.
struct YamlValue {
  int line = 0;
  std::string text;             // of a scalar
  std::vector<double> numbers;  // of a list of numbers, or of a scalar that is one
};

Result<std::map<std::string, YamlValue>> ParseOpenCvYaml(const RigText& file) {
  const std::vector<Line> lines = LinesOf(file.text);
  std::map<std::string, YamlValue> values;
  std::vector<std::pair<std::size_t, std::string>> open;  // indentation and path of the parents
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const std::string_view text = lines[i].text;
    const std::size_t indent = text.find_first_not_of(' ');
    if (indent == std::string_view::npos || text.starts_with("%") || text == "---") continue;
    const std::string where = fmt::format("{}:{}", file.name, lines[i].number);
    const std::size_t colon = text.find(':');
    if (colon == std::string_view::npos) {
      return Fail(ErrorKind::kData, "{}: {}, expected key: value", where, Shown(text));
    }
    while (!open.empty() && open.back().first >= indent) open.pop_back();
    if (open.size() > 8) {
      return Fail(ErrorKind::kData, "{}: nested too deep, expected at most 8 levels", where);
    }
    const std::string_view key = text.substr(indent, colon - indent);
    const std::string path =
        open.empty() ? std::string(key) : fmt::format("{}.{}", open.back().second, key);
    if (path.size() > 256) {
      return Fail(ErrorKind::kData, "{}: {}, expected shorter keys", where, Shown(path));
    }
    std::string value(text.substr(colon + 1));
    value.erase(0, std::min(value.find_first_not_of(' '), value.size()));
    YamlValue parsed;
    parsed.line = lines[i].number;
    if (value.empty() || value.starts_with("!!")) {
      open.emplace_back(indent, path);
    } else if (value.front() == '[') {
      while (value.find(']') == std::string::npos && i + 1 < lines.size()) {
        value += ' ';
        value += lines[++i].text;
      }
      const std::size_t end = value.find(']');
      if (end == std::string::npos) {
        return Fail(ErrorKind::kData, "{}: {}: a list without an end, expected ]", where, path);
      }
      for (const std::string_view part :
           Split(std::string_view(value).substr(1, end - 1), ", \t")) {
        const std::optional<double> number = NumberOf(part);
        if (!number) {
          return Fail(ErrorKind::kData, "{}: {}: {}, expected numbers", where, path, Shown(part));
        }
        parsed.numbers.push_back(*number);
      }
    } else {
      parsed.text = Shown(value);
      if (const std::optional<double> number = NumberOf(value)) parsed.numbers = {*number};
    }
    if (!values.emplace(path, std::move(parsed)).second) {
      return Fail(ErrorKind::kData, "{}: {}: twice, expected once", where, path);
    }
  }
  return values;
}

class VuzeLens {
 public:
  VuzeLens(const std::map<std::string, YamlValue>& values, const RigText& file, int index)
      : values_(values), file_(file), index_(index) {}

  bool Exists() const { return values_.count(Path("")) > 0; }

  tl::unexpected<Error> Wrong(std::string_view key, const std::string& why) const {
    const auto found = values_.find(Path(key));
    return Fail(ErrorKind::kData, "{}:{}: {}: {}", file_.name,
                found == values_.end() ? values_.at(Path("")).line : found->second.line, Path(key),
                why);
  }

  Result<std::vector<double>> Numbers(std::string_view key, std::size_t count) const {
    const auto found = values_.find(Path(key));
    if (found == values_.end()) {
      return Wrong(key, fmt::format("missing, expected {} numbers", count));
    }
    if (found->second.numbers.size() != count) {
      return Wrong(key,
                   fmt::format("{} numbers, expected {}", found->second.numbers.size(), count));
    }
    return found->second.numbers;
  }

  Result<double> Number(std::string_view key) const {
    OMNIHDR_ASSIGN(const std::vector<double> numbers, Numbers(key, 1));
    return numbers[0];
  }

  Result<RigSensor> Sensor(const RigImportOptions& options) const {
    OMNIHDR_ASSIGN(const double version, Number("VERSION"));
    if (version != 3.0) return Wrong("VERSION", fmt::format("{}, expected 3", version));
    OMNIHDR_ASSIGN(const std::vector<double> k, Numbers("K.data", 9));
    if (!(k[0] > 0.0 && k[4] > 0.0) || k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 ||
        k[8] != 1.0) {
      return Wrong("K.data", "expected [f, 0, cx, 0, f, cy, 0, 0, 1]");
    }
    OMNIHDR_ASSIGN(const std::vector<double> r, Numbers("R.data", 9));
    Eigen::Matrix3d rotation;
    rotation << r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8];
    if (!((rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 &&
          rotation.determinant() > 0.0)) {
      return Wrong("R.data", "expected a rotation");
    }
    OMNIHDR_ASSIGN(const std::vector<double> millimetres, Numbers("CamCenter.data", 3));
    OMNIHDR_ASSIGN(const std::vector<double> size, Numbers("StraightSrcImageSize", 2));
    for (const double side : size) {
      if (!(side >= 1.0 && side <= 65536.0 && side == std::floor(side))) {
        return Wrong("StraightSrcImageSize", "expected two sides of 1 to 65536 pixels");
      }
    }
    OMNIHDR_ASSIGN(const auto distortion, Distortion());
    OMNIHDR_ASSIGN(const double half_fov_deg, Number("Fov_deg"));
    if (!(half_fov_deg > 0.0 && half_fov_deg < 180.0)) {
      return Wrong("Fov_deg", fmt::format("{}, expected 0 to 180 degrees", half_fov_deg));
    }
    OMNIHDR_ASSIGN(const double circle, Number("ImageCircleRadius"));
    const double theta = half_fov_deg * kDegree;
    double curve = 0.0;
    for (std::size_t i = distortion.size(); i-- > 0;)
      curve = (curve + distortion[i]) * theta * theta;
    const double radius = k[0] * theta * (1.0 + curve);
    if (!(std::abs(radius - circle) < 0.01 * circle)) {
      return Wrong(
          "ImageCircleRadius",
          fmt::format("{}, expected {:.6g}, where the distortion puts Fov_deg", circle, radius));
    }
    double fov_deg = options.fov_deg > 0.0 ? options.fov_deg : kFisheyeFovDeg;
    fov_deg = std::min(fov_deg, 2.0 * half_fov_deg);
    const double wanted = std::min(0.5 * fov_deg * kDegree, theta);
    const double unfolded = Lens::UnfoldedAngle(LensKind::kFisheye, distortion, wanted);
    const double max_angle = unfolded < wanted ? unfolded * (1.0 - 1e-9) : wanted;
    RigSensor sensor;
    sensor.name = fmt::format("{}", index_ + 1);
    const int straight_width = static_cast<int>(size[0]);
    const int straight_height = static_cast<int>(size[1]);
    // straight (u, v) = (straight_width − y, x) of the stored picture.
    Result<Lens> lens =
        Lens::Fisheye(straight_height, straight_width, {k[4], k[0]},
                      {k[5] + 0.5, straight_width - (k[2] + 0.5)}, distortion, max_angle);
    if (!lens) return Wrong("", lens.error().message);
    sensor.lens = *std::move(lens);
    Eigen::Matrix3d straight_from_stored;
    straight_from_stored << 0, -1, 0, 1, 0, 0, 0, 0, 1;
    Eigen::Matrix3d rig_from_vuze;
    rig_from_vuze << 0, 0, 1, 1, 0, 0, 0, 1, 0;
    sensor.camera_from_sensor.rotation =
        Eigen::Quaterniond(Eigen::Matrix3d(rig_from_vuze * rotation * straight_from_stored))
            .normalized();
    sensor.camera_from_sensor.translation =
        rig_from_vuze * Eigen::Vector3d(millimetres[0], millimetres[1], millimetres[2]) * 1e-3;
    return sensor;
  }

 private:
  std::string Path(std::string_view key) const {
    return key.empty() ? fmt::format("CamModel_V2_Set.CAM_{}", index_)
                       : fmt::format("CamModel_V2_Set.CAM_{}.{}", index_, key);
  }

  Result<std::array<double, 5>> Distortion() const {
    std::array<double, 5> even{};
    for (std::size_t i = 0; i <= 10; ++i) {
      const std::string key = fmt::format("DistortionCoeffs_{}", i);
      OMNIHDR_ASSIGN(const double value, Number(key));
      const bool fixed = i == 0 || i % 2 == 1;
      if (fixed && value != (i == 0 ? 1.0 : 0.0)) {
        return Wrong(
            key, fmt::format("{}, expected {} of an even angle polynomial", value, i == 0 ? 1 : 0));
      }
      if (!fixed) even[i / 2 - 1] = value;
    }
    return even;
  }

  const std::map<std::string, YamlValue>& values_;
  const RigText& file_;
  int index_;
};

Result<Rig> ImportVuze(const std::vector<RigText>& files, const RigImportOptions& options) {
  const RigText& file = files.front();
  if (files.size() != 1) {
    return Fail(ErrorKind::kUsage, "{}: expected one file of this kind", files[1].name);
  }
  if (options.width > 0 || options.height > 0) {
    return Fail(ErrorKind::kUsage, "{}: the file tells the size itself, expected none given",
                file.name);
  }
  OMNIHDR_ASSIGN(const auto values, ParseOpenCvYaml(file));
  Rig rig;
  for (int i = 0; i < kMaxVuzeLenses; ++i) {
    const VuzeLens lens(values, file, i);
    if (!lens.Exists()) break;
    OMNIHDR_ASSIGN(RigSensor sensor, lens.Sensor(options));
    rig.sensors.push_back(std::move(sensor));
  }
  if (rig.sensors.empty()) {
    return Fail(ErrorKind::kData, "{}: CamModel_V2_Set.CAM_0: missing, expected a lens", file.name);
  }
  OMNIHDR_TRY(rig.Validate().Context(file.name));
  return rig;
}

}  // namespace

std::string_view ToString(RigTextKind kind) {
  switch (kind) {
    case RigTextKind::kLadybugCsv:
      return "ladybug-csv";
    case RigTextKind::kLadybugText:
      return "ladybug-text";
    case RigTextKind::kVuzeYml:
      return "vuze";
  }
  return "?";
}

std::optional<RigTextKind> RigTextKindFromString(std::string_view name) {
  for (const RigTextKind kind :
       {RigTextKind::kLadybugCsv, RigTextKind::kLadybugText, RigTextKind::kVuzeYml}) {
    if (name == ToString(kind)) return kind;
  }
  return std::nullopt;
}

Result<Rig> ImportRig(const std::vector<RigText>& files, const RigImportOptions& options) {
  if (files.empty()) return Fail(ErrorKind::kUsage, "no file, expected a calibration text");
  for (const RigText& file : files) {
    if (file.text.size() > kMaxTextBytes) {
      return Fail(ErrorKind::kData, "{}: {} bytes, expected at most {}", file.name,
                  file.text.size(), kMaxTextBytes);
    }
  }
  std::optional<RigTextKind> kind = options.kind;
  const std::string_view text = files.front().text;
  if (!kind) {
    if (IsInteriorTable(text) || IsExteriorTable(text)) {
      kind = RigTextKind::kLadybugCsv;
    } else if (text.find("CamModel_V2_Set:") != std::string_view::npos) {
      kind = RigTextKind::kVuzeYml;
    } else if (text.find("camera0_rotX=") != std::string_view::npos) {
      kind = RigTextKind::kLadybugText;
    }
  }
  if (!kind) {
    return Fail(ErrorKind::kData,
                "{}: not a calibration that can be imported, expected the two CSV tables of a "
                "six-sensor head, a text of cameraN_rotX=… lines, or an OpenCV YAML with "
                "CamModel_V2_Set (factory files with look-up grids have no public layout: write "
                "their samples as a lens = \"grid\" of rig.toml)",
                files.front().name);
  }
  switch (*kind) {
    case RigTextKind::kLadybugCsv:
      return ImportLadybugCsv(files, options);
    case RigTextKind::kLadybugText:
      return ImportLadybugText(files, options);
    case RigTextKind::kVuzeYml:
      return ImportVuze(files, options);
  }
  return Fail(ErrorKind::kSoftware, "unknown kind of calibration text");
}

}  // namespace omnihdr
