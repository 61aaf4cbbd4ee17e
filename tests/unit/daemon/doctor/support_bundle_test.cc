#include "daemon/doctor/support_bundle.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <string>

#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::support_bundle_test {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Key;
using ::testing::Not;

class SupportBundle : public ::testing::Test {
 protected:
  void SetUp() override {
    const fs::path session = path() / "sessions" / "20260101T000000Z";
    fs::create_directories(session / "views/000000");
    testing::WriteText(session / "session.json", R"({"created": "2026-01-01T00:00:00Z"})");
    testing::WriteText(session / "frames.jsonl",
                       R"({"frame": 0, "gnss": {"lat": 45.4215, "lon": -75.69, "fix": 4}})"
                       "\n{\"frame\": 1, \"po");
    testing::WriteText(session / "raw.png", "PIXELS");
    testing::WriteText(session / "views/000000/view.json",
                       R"({"position": 0, "resume": {"after": 0}})");
    testing::WriteText(path() / "c.toml",
                       "[session]\ndirectory = \"sessions\"\n[api]\nsocket = \"api.sock\"\n");
    options_.doctor.config = path() / "c.toml";
    options_.doctor.measure_disk = false;
    options_.doctor.timeout = std::chrono::milliseconds(200);
    options_.out = path() / "bundle.tar.gz";
    machine_ = doctor::RealMachine();
    machine_.run = [this](const std::vector<std::string>& words) -> Result<std::string> {
      if (words[0] == "journalctl") return log_;
      return Fail(ErrorKind::kUnavailable, "{}: not here", words[0]);
    };
  }
  // What a receiver of the bundle finds in it.
  std::map<std::string, std::string> Unpacked() {
    const fs::path to = path() / "unpacked";
    fs::remove_all(to);
    fs::create_directories(to);
    const auto said = doctor::RunProgram({"tar", "-xzf", options_.out.string(), "-C", to.string()},
                                         std::chrono::seconds(30));
    EXPECT_TRUE(said) << said.error().message;
    std::map<std::string, std::string> files;
    for (const auto& entry : fs::recursive_directory_iterator(to)) {
      if (!entry.is_regular_file()) continue;
      files[fs::relative(entry.path(), to / "omnihdr-support").string()] =
          testing::FileText(entry.path());
    }
    return files;
  }
  const fs::path& path() const { return directory_.path(); }

  testing::TemporaryDirectory directory_;
  doctor::BundleOptions options_;
  doctor::Machine machine_;
  std::string log_ = "omnihdrd started\n";
};

TEST_F(SupportBundle, HoldsWhatAHelperNeedsWithTheDaemonDown) {
  const Result<doctor::BundleReport> report = doctor::WriteSupportBundle(options_, machine_);
  ASSERT_TRUE(report) << report.error().message;
  const auto files = Unpacked();
  for (const char* name :
       {"manifest.json", "versions.txt", "doctor.json", "log.txt", "config/c.toml",
        "config/in-force.toml", "usb.txt", "devices.txt", "system.txt",
        "sessions/20260101T000000Z/session.json", "sessions/20260101T000000Z/frames-tail.jsonl",
        "sessions/20260101T000000Z/views/000000.json"}) {
    EXPECT_THAT(files, Contains(Key(name)));
  }
  EXPECT_THAT(report->missing, Contains(HasSubstr("status.json: ")));
  EXPECT_THAT(files.at("manifest.json"), HasSubstr("status.json: "));
  EXPECT_EQ(report->bytes, fs::file_size(options_.out));
}

TEST_F(SupportBundle, NamesThePackageOfEveryLibraryThatIsLoaded) {
  fs::path library;
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line) && library.empty();) {
    if (line.find("/libstdc++.so.") != std::string::npos) library = line.substr(line.find('/'));
  }
  library = fs::canonical(library);
  ASSERT_FALSE(library.empty());
  // Packages give paths without /usr, too, and the loader either.
  const std::string in_package = library.string().substr(library.string().find("/lib/"));
  std::vector<std::vector<std::string>> asked;
  machine_.run = [&](const std::vector<std::string>& words) -> Result<std::string> {
    if (words[0] != "dpkg-query") return Fail(ErrorKind::kUnavailable, "{}: not here", words[0]);
    asked.push_back(words);
    if (words[1] == "-W") return "libstdc++6:amd64\t12.2.0\n";
    return fmt::format(
        "dpkg-query: no path found matching pattern /opt/own.so\n"
        "diversion by dash from: /bin/sh\nlibstdc++6:amd64, second: {}\n",
        in_package);
  };
  ASSERT_TRUE(doctor::WriteSupportBundle(options_, machine_));
  ASSERT_EQ(asked.size(), 2U);
  EXPECT_EQ(asked[0][1], "--search");
  EXPECT_THAT(asked[0], Contains(in_package));
  EXPECT_THAT(asked[1],
              ::testing::ElementsAre("dpkg-query", "-W", "gpsd", "libgpiod*", "libstdc++6:amd64",
                                     "omnihdr", "second", "systemd", "udev"));
  const std::string versions = Unpacked().at("versions.txt");
  EXPECT_THAT(versions, HasSubstr("libstdc++6:amd64\t12.2.0"));
  EXPECT_THAT(versions, HasSubstr(library.string()));
}

TEST_F(SupportBundle, HoldsNoPixelsNoPlacesAndNoSecrets) {
  // A section that this version does not know is in the file all the same.
  testing::WriteText(path() / "c.toml",
                     "[session]\ndirectory = \"sessions\"\n[api]\nsocket = \"api.sock\"\n"
                     "[upload]\npassword = \"hunter2\"\nurl = \"ftp://me:hunter2@192.0.2.1/\"\n");
  log_ = "upload with token=hunter2 begins\n";
  ASSERT_TRUE(doctor::WriteSupportBundle(options_, machine_));
  const auto files = Unpacked();
  EXPECT_THAT(files.at("config/c.toml"), HasSubstr("password = \"(removed)\""));
  for (const auto& [name, text] : files) {
    EXPECT_THAT(text, Not(HasSubstr("hunter2"))) << name;
    EXPECT_THAT(text, Not(HasSubstr("45.4215"))) << name;
    EXPECT_THAT(text, Not(HasSubstr("PIXELS"))) << name;
  }
  EXPECT_THAT(files.at("sessions/20260101T000000Z/frames-tail.jsonl"), HasSubstr("\"fix\":4"));
}

TEST_F(SupportBundle, IsBoundedWhateverTheLogsHold) {
  for (int k = 0; k < 200'000; ++k) log_ += fmt::format("line {} of a long log\n", k);
  const Result<doctor::BundleReport> report = doctor::WriteSupportBundle(options_, machine_);
  ASSERT_TRUE(report) << report.error().message;
  const auto files = Unpacked();
  std::size_t all = 0;
  for (const auto& [name, text] : files) {
    EXPECT_LE(text.size(), std::size_t{1} << 20) << name;
    all += text.size();
  }
  EXPECT_LE(all, std::size_t{16} << 20);
  EXPECT_THAT(files.at("log.txt"), HasSubstr("line 199999 of"));
}

TEST_F(SupportBundle, ThatCannotBeWrittenIsAnErrorAndLeavesNothing) {
  options_.out = path() / "none" / "bundle.tar.gz";
  const Result<doctor::BundleReport> report = doctor::WriteSupportBundle(options_, machine_);
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().kind, ErrorKind::kCannotCreate);
  EXPECT_THAT(report.error().message, HasSubstr("bundle.tar.gz"));
}

TEST(WithoutSecrets, ValuesNamedLikeSecretsAreRemovedAndNothingElse) {
  const auto without = [](const std::string& text) { return doctor::WithoutSecrets(text); };
  EXPECT_EQ(without("token = \"abc\"  # note"), "token = \"(removed)\"  # note\n");
  EXPECT_EQ(without("mqtt_password='a b'"), "mqtt_password=\"(removed)\"\n");
  EXPECT_EQ(without(R"({"api_key": "x\"y", "port": 5})"),
            "{\"api_key\": \"(removed)\", \"port\": 5}\n");
  EXPECT_EQ(without("get https://a:b@192.0.2.1/x"), "get https://(removed)@192.0.2.1/x\n");
  for (const char* kept : {"keyframes = 64", "socket = \"/run/omnihdr/api.sock\"",
                           "exposures_s = [0.001, 0.004]", "key = 5"}) {
    EXPECT_EQ(without(kept), std::string(kept) + "\n");
  }
}

}  // namespace
}  // namespace omnihdr::support_bundle_test
