#include <fmt/chrono.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/image/image_io.h"
#include "core/session/journal.h"
#include "core/session/rig_file.h"
#include "core/session/session_rig.h"
#include "daemon/cli/command.h"
#include "drivers/ladybug/pgr_file.h"

namespace omnihdr {
namespace {

struct ImportArguments {
  std::vector<std::string> files;
  std::string out;
  std::string rig;
  double shutter_step_s = 0.0;
  double gain_step_db = 0.0;
  int gain_zero = 0;
  int png_compression = 1;
};

// What the words of a stream's frames mean; the stream itself does not say.
class ExposureWords {
 public:
  explicit ExposureWords(const ImportArguments& arguments) : arguments_(arguments) {}
  Result<Exposure> Read(const ladybug::JpegFrameHeader& header) {
    const int gain = static_cast<int>(header.gains.front() & 0xFFF);
    if (!first_gain_) first_gain_ = gain;
    if (arguments_.gain_step_db == 0.0 && gain != *first_gain_) {
      return Fail(ErrorKind::kUsage,
                  "the gain changes from {} to {}: expected --gain-step, decibels of one step",
                  *first_gain_, gain);
    }
    Exposure exposure;
    exposure.time = ExposureTime::Seconds(static_cast<double>(header.shutters.front() & 0xFFF) *
                                          arguments_.shutter_step_s);
    exposure.gain = GainDb{arguments_.gain_step_db * (gain - arguments_.gain_zero)};
    return exposure;
  }

 private:
  const ImportArguments& arguments_;
  std::optional<int> first_gain_;
};

// Time of each frame since the first: the recording host's clock where it was written, else the
// camera's cycles, which wrap after 128 s.
class FrameTimes {
 public:
  HostTime Next(const ladybug::JpegFrameHeader& header) {
    const std::int64_t cycles = std::int64_t{header.cycle_time >> 25} * 8000 +
                                std::min(header.cycle_time >> 12 & 0x1FFF, 7999U);
    const std::int64_t utc = Utc(header);
    if (last_cycles_) {
      constexpr std::int64_t kWrap = std::int64_t{128} * 8000;
      const std::int64_t step = (cycles - *last_cycles_ + kWrap) % kWrap * 125'000;
      const bool host_clock = utc > 0 && last_utc_ > 0 && utc >= last_utc_;
      now_ = now_ + Nanoseconds(host_clock ? utc - last_utc_ : step);
    }
    last_cycles_ = cycles;
    last_utc_ = utc;
    return now_;
  }
  static std::int64_t Utc(const ladybug::JpegFrameHeader& header) {
    if (header.seconds == 0) return 0;
    return std::int64_t{header.seconds} * 1'000'000'000 +
           std::int64_t{std::min(header.microseconds, 999'999U)} * 1000;
  }

 private:
  std::optional<std::int64_t> last_cycles_;
  std::int64_t last_utc_ = 0;
  HostTime now_ = HostTime::FromNanoseconds(0);
};

struct ImportCounts {
  std::uint64_t frames = 0;
  std::uint64_t lost = 0;
  std::uint64_t damaged = 0;
  std::string last_damage;
};

class Importer {
 public:
  Importer(const ImportArguments& arguments, Rig rig, std::vector<SessionFile> files)
      : arguments_(arguments), rig_(std::move(rig)), files_(std::move(files)), words_(arguments) {}

  Status Add(const std::string& name) {
    OMNIHDR_ASSIGN(auto source, ladybug::OpenPgrFile(name));
    Result<ladybug::PgrReader> reader = ladybug::PgrReader::Open(std::move(source));
    if (!reader) return Forward(std::move(reader).error(), name);
    const std::string head = fmt::format("{}", reader->header().head_serial);
    if (!rig_.serial.empty() && rig_.serial != head) {
      return Fail(ErrorKind::kConfig, "{}: head {}: the rig file is the calibration of head {}",
                  name, head, rig_.serial);
    }
    const std::uint64_t before = counts_.frames;
    while (true) {
      Result<std::optional<ladybug::PgrReader::Frame>> frame = reader->Next();
      if (!frame) return Forward(std::move(frame).error(), name);
      if (!*frame) break;
      if (!writer_) OMNIHDR_TRY(Begin((*frame)->header, head));
      OMNIHDR_TRY(Store(**frame).Context(fmt::format("{}: byte {}", name, (*frame)->offset)));
    }
    counts_.damaged += reader->damaged();
    if (reader->damaged() > 0)
      counts_.last_damage = fmt::format("{}: {}", name, reader->last_damage());
    if (counts_.frames == before) {
      return Fail(ErrorKind::kData,
                  "{}: no compressed frame in it (data format {} of the stream): expected "
                  "colour-separated JPEG{}{}",
                  name, reader->header().data_format, reader->damaged() > 0 ? ": " : "",
                  reader->last_damage());
    }
    return {};
  }
  const ImportCounts& counts() const { return counts_; }

 private:
  Status Begin(const ladybug::JpegFrameHeader& first, const std::string& head) {
    SessionInfo info;
    info.created =
        fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(static_cast<std::time_t>(first.seconds)));
    info.camera.model = rig_.model.empty() ? "Ladybug" : rig_.model;
    info.camera.serial = head;
    info.camera.bits = 8;
    info.camera.layout = Layout::kRig;
    info.camera.width = rig_.sensors.front().lens.width();
    info.camera.height = ladybug::kSensors * rig_.sensors.front().lens.height();
    info.camera.bayer = ToString(BayerOrder::kBggr);
    info.files = files_;
    info.extra_json = nlohmann::json{{"import",
                                      {{"files", arguments_.files},
                                       {"shutter_step_s", arguments_.shutter_step_s},
                                       {"gain_step_db", arguments_.gain_step_db},
                                       {"gain_zero", arguments_.gain_zero}}}}
                          .dump();
    OMNIHDR_ASSIGN(writer_, SessionWriter::Create(arguments_.out, info));
    return {};
  }

  Status Store(const ladybug::PgrReader::Frame& frame) {
    if (last_sequence_ && frame.header.sequence > *last_sequence_ + 1) {
      counts_.lost += frame.header.sequence - *last_sequence_ - 1;
    }
    last_sequence_ = frame.header.sequence;
    FrameRecord record;
    record.frame = FrameId{counts_.frames};
    record.position = PositionId{static_cast<std::int64_t>(counts_.frames)};
    record.trigger_time = times_.Next(frame.header);
    record.timestamp = record.trigger_time;
    if (const std::int64_t utc = FrameTimes::Utc(frame.header); utc > 0) {
      record.utc = UtcTime::FromNanoseconds(utc);
    }
    OMNIHDR_ASSIGN(record.exposure, words_.Read(frame.header));
    record.proof = ExposureProof::kEmbedded;
    std::vector<std::byte> png;
    const auto unusable = [&record](FrameStatus status, std::string why) {
      record.status = status;
      record.detail = std::move(why);
    };
    if (!record.exposure.IsValid()) {
      return Fail(ErrorKind::kData, "shutter word {:#x}: expected more than 0",
                  frame.header.shutters.front());
    }
    if (!frame.header.IsOneExposure()) {
      unusable(FrameStatus::kExposureMismatch, "the sensors had different exposures");
    } else {
      const RigSensor& sensor = rig_.sensors.front();
      const auto stack = ladybug::DecodeJpegFrame(frame.bytes, frame.header, sensor.lens.width(),
                                                  sensor.lens.height());
      if (stack) {
        record.file = fmt::format("raw/{:06}.png", counts_.frames);
        OMNIHDR_ASSIGN(png, EncodePng(stack->view(), arguments_.png_compression));
      } else {
        unusable(FrameStatus::kCorrupt, stack.error().message);
      }
    }
    ++counts_.frames;
    return writer_->Append(record, png);
  }

  const ImportArguments& arguments_;
  const Rig rig_;
  const std::vector<SessionFile> files_;
  ExposureWords words_;
  FrameTimes times_;
  std::optional<SessionWriter> writer_;
  std::optional<std::uint32_t> last_sequence_;
  ImportCounts counts_;
};

Result<int> Import(const ImportArguments& arguments) {
  OMNIHDR_ASSIGN(std::vector<SessionFile> files, ReadRigFilesOf(arguments.rig));
  OMNIHDR_ASSIGN(Rig rig, ParseRig(files.front().content, arguments.rig));
  bool fits = rig.sensors.size() == ladybug::kSensors;
  for (const RigSensor& sensor : rig.sensors) {
    fits = fits && sensor.bayer == BayerOrder::kBggr &&
           sensor.lens.width() == rig.sensors.front().lens.width() &&
           sensor.lens.height() == rig.sensors.front().lens.height();
  }
  if (!fits) {
    return Fail(ErrorKind::kConfig, "{}: expected {} sensors of one size, bayer = \"BGGR\"",
                arguments.rig, ladybug::kSensors);
  }
  Importer importer(arguments, std::move(rig), std::move(files));
  for (const std::string& file : arguments.files) OMNIHDR_TRY(importer.Add(file));
  const ImportCounts& counts = importer.counts();
  fmt::print("{}: {} frames\n", arguments.out, counts.frames);
  if (counts.lost > 0) {
    fmt::print("{} frames are missing by their sequence numbers\n", counts.lost);
  }
  if (counts.damaged > 0) {
    fmt::print("{} damaged frames passed over, the last: {}\n", counts.damaged, counts.last_damage);
  }
  return 0;
}

}  // namespace

void AddImportCommand(CLI::App& app, CommandRun& run) {
  auto arguments = std::make_shared<ImportArguments>();
  CLI::App* command = app.add_subcommand(
      "import", "Make a session from recorded Ladybug streams (.pgr, colour-separated JPEG)");
  command->add_option("FILE", arguments->files, "Streams of one recording, in order")->required();
  command->add_option("--out", arguments->out, "Session directory to make")->required();
  command->add_option("--rig", arguments->rig, "Rig file of the head")->required();
  command
      ->add_option("--shutter-step", arguments->shutter_step_s,
                   "Seconds of one step of the shutter word: a stream holds register values, and "
                   "what they stand for is the camera's")
      ->required()
      ->check(CLI::Range(1e-9, 1.0));
  command
      ->add_option("--gain-step", arguments->gain_step_db,
                   "Decibels of one step of the gain word [0: the gain never changes]")
      ->check(CLI::Range(0.0, 10.0));
  command->add_option("--gain-zero", arguments->gain_zero, "Gain word of 0 dB")
      ->check(CLI::Range(0, 4095))
      ->capture_default_str();
  command->add_option("--png-compression", arguments->png_compression, "0 (fast) to 9 (small)")
      ->check(CLI::Range(0, 9))
      ->capture_default_str();
  command->callback([arguments, &run] { run = [arguments] { return Import(*arguments); }; });
}

}  // namespace omnihdr
