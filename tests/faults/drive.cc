#include "tests/faults/drive.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cstdlib>
#include <fstream>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "daemon/session_choice.h"
#include "drivers/sim/simulation.h"

namespace omnihdr::faults {
namespace {

namespace fs = std::filesystem;
using integration::Eventually;
using integration::FilesBelow;
using integration::Program;

// raw and views, without what an interrupted writer may leave there under no frame's or view's name
// until the next start.
bool IsResult(const std::string& name) {
  return (name.starts_with("raw/") && !name.ends_with(".tmp")) ||
         (name.starts_with("views/") && name[6] != '.' && !name.ends_with(".tmp"));
}

}  // namespace

std::uint64_t FromEnvironment(const char* name, std::uint64_t otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : std::strtoull(text, nullptr, 10);
}

std::vector<std::string> ComparableLines(const fs::path& session) {
  const auto contents = ReadSession(session);
  if (!contents) return {contents.error().message};
  std::vector<std::string> lines;
  for (const FrameRecord& r : contents->journal.frames) {
    lines.push_back(fmt::format("{} {} {} {} {} {} {} {}", Value(r.frame), Value(r.position),
                                r.file, r.exposure.time.seconds(), r.odometer_m.value_or(-1.0),
                                ToString(r.status), r.crc32c.value_or(0), ToString(r.proof)));
  }
  return lines;
}

RecordedDrive::RecordedDrive(int positions, const std::string& trigger)
    : positions_(positions), faults_(directory() / "faults", session()) {
  sim::SimulateOptions options;
  options.simulation.scene = sim::SceneKind::kTunnel;
  options.simulation.width = 256;
  options.bracket.start = ExposureTime::Seconds(0.004);
  options.bracket.step = Stops{1.6};
  options.positions = positions;
  // A trigger by command knows no place: only the replay trigger hands the recorded one on.
  options.write_odometer = trigger == "replay";
  options.created = "2026-01-01T00:00:00Z";
  const omnihdr::Status written = sim::WriteSimulatedSession(directory() / "source", options, {});
  EXPECT_TRUE(written) << written.error().message;
  std::ofstream(directory() / "c.toml") << fmt::format(
      "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
      "[camera]\ndriver = \"replay\"\nreconnect_s = 0.2\n"
      "[camera.replay]\nsession = \"source\"\n"
      "[trigger]\nsource = \"{}\"\narmed_at_start = true\n"
      "[stereo]\nwidth = 256\nlabels = 32\n"
      "[storage]\nallow_root = true\nwarn_free_mb = 0\nstop_free_mb = 0\nwarn_minutes = 0\n",
      trigger);
}

std::unique_ptr<Program> RecordedDrive::Start() const {
  return std::make_unique<Program>(
      "omnihdrd", std::vector<std::string>{"--config", (directory() / "c.toml").string()},
      directory() / "log", faults_.Environment());
}

nlohmann::json RecordedDrive::Status() const {
  auto status = Client().Get("/v1/status");
  return status ? *status : nlohmann::json();
}

bool RecordedDrive::StatusHolds(const std::function<bool(const nlohmann::json&)>& holds) const {
  return Eventually([&] {
    const nlohmann::json status = Status();
    return status.is_object() && holds(status);
  });
}

std::string RecordedDrive::Log() const {
  return ReadTextFile(directory() / "log").value_or("no log");
}

const Reference& RecordedDrive::Undisturbed() {
  faults_.Clear();
  const auto daemon = Start();
  EXPECT_TRUE(Eventually([&] { return Ended() || !daemon->running(); })) << Log();
  daemon->Signal(SIGTERM);
  EXPECT_EQ(daemon->Wait(), 0) << Log();
  for (auto& [name, bytes] : FilesBelow(session())) {
    if (IsResult(name)) reference_.files[name] = std::move(bytes);
  }
  reference_.lines = ComparableLines(session());
  EXPECT_EQ(reference_.lines.size(), static_cast<std::size_t>(positions_));
  Fresh();
  return reference_;
}

std::string RecordedDrive::JournalText() const {
  std::string text = ReadTextFile(session() / "frames.jsonl").value_or("");
  const std::size_t end = text.rfind('\n');
  text.resize(end == std::string::npos ? 0 : end + 1);
  return text;
}

std::string RecordedDrive::Damage(bool strict) const {
  if (!fs::exists(session() / "session.json")) return {};
  std::vector<std::string> arguments = {"verify", session().string()};
  if (strict) arguments.emplace_back("--strict");
  const auto [code, output] = integration::RunOmnihdr(arguments, directory());
  return code == 0 ? "" : fmt::format("exit code {}: {}", code, output);
}

std::vector<std::string> RecordedDrive::Problems(const std::string& earlier) const {
  std::vector<std::string> problems;
  if (!JournalText().starts_with(earlier)) {
    problems.emplace_back("the journal lacks lines that were in it");
  }
  if (!fs::exists(session() / "session.json")) return problems;  // no session yet
  const auto contents = ReadSession(session());
  if (!contents) return {contents.error().message};
  for (const std::string& line : contents->journal.rejected) problems.push_back(line);
  const std::vector<std::string> lines = ComparableLines(session());
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (i >= reference_.lines.size() || lines[i] != reference_.lines[i]) {
      problems.push_back("the journal has another line: " + lines[i]);
    }
  }
  for (const FrameRecord& record : contents->journal.frames) {
    if (record.status != FrameStatus::kOk) continue;
    const auto bytes = ReadFile(session() / record.file);
    if (!bytes) {
      problems.push_back(bytes.error().message);
    } else if (Crc32c(*bytes) != record.crc32c) {
      problems.push_back(record.file + ": not the pixels that were journaled");
    }
  }
  const auto views = CompleteViews(session() / "views");
  if (!views) problems.push_back(views.error().message);
  std::error_code error;
  for (fs::directory_iterator it(session() / "views", error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = it->path().filename().string();
    if (name.front() == '.') continue;
    for (const char* file : {"radiance.exr", "disparity.exr", "preview.jpg", "view.json"}) {
      const std::string path = fmt::format("views/{}/{}", name, file);
      const auto found = reference_.files.find(path);
      if (found == reference_.files.end()) {
        problems.push_back(path + ": such a view is not in the reference");
      } else if (ReadTextFile(session() / path).value_or("") != found->second) {
        problems.push_back(path + ": half a view, or another one");
      }
    }
  }
  return problems;
}

std::vector<std::string> RecordedDrive::Differences() const {
  std::vector<std::string> differences = Problems();
  if (ComparableLines(session()) != reference_.lines) {
    differences.emplace_back("the journal is not the reference's");
  }
  const auto files = FilesBelow(session());
  for (const auto& [name, bytes] : reference_.files) {
    const auto found = files.find(name);
    if (found == files.end()) {
      differences.push_back(name + ": missing");
    } else if (found->second != bytes) {
      differences.push_back(name + ": other bytes");
    }
  }
  for (const auto& [name, bytes] : files) {
    const bool beside = name == "session.json" || name == "frames.jsonl" || name == "ended.json" ||
                        name == "timings.jsonl";
    if (!beside && !reference_.files.contains(name)) differences.push_back(name + ": left over");
  }
  return differences;
}

}  // namespace omnihdr::faults
