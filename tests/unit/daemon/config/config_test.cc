#include "daemon/config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <string>
#include <vector>

#include "core/base/file.h"

namespace omnihdr::config_test {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

const fs::path kConfigFolder = fs::path(OMNIHDR_SOURCE_DIR) / "config";

class TemporaryDirectory {
 public:
  TemporaryDirectory() {
    std::string pattern = (fs::temp_directory_path() / "omnihdr-config-XXXXXX").string();
    path_ = ::mkdtemp(pattern.data());
  }
  ~TemporaryDirectory() { fs::remove_all(path_); }
  const fs::path& path() const { return path_; }
  void Write(const std::string& name, const std::string& text) const {
    fs::create_directories((path_ / name).parent_path());
    std::ofstream(path_ / name) << text;
  }

 private:
  fs::path path_;
};

// The only problem of a text, as it would be printed; fails the test when there is not exactly one.
std::string OnlyProblem(const std::string& toml) {
  const LoadedConfig loaded = ParseConfig(toml, "dir/test.toml");
  EXPECT_EQ(loaded.problems.size(), 1U) << toml;
  std::string all;
  for (const ConfigProblem& problem : loaded.problems) all += problem.ToString() + "\n";
  if (!all.empty()) all.pop_back();
  return all;
}

std::string Value(const DaemonConfig& config, const std::string& key) {
  const Result<std::string> value = ConfigValueToToml(config, key);
  return value ? *value : value.error().message;
}

TEST(Config, ABurstWantsAWholeBracketAndABlurBoundASpeed) {
  const LoadedConfig loaded = ParseConfig(
      "[bracket]\nframes_per_position = 2\norder = \"triangle\"\nmax_blur_px = 2.0\n"
      "[trigger]\nburst = true\n",
      "c.toml");
  std::string problems;
  for (const ConfigProblem& problem : loaded.problems) problems += problem.ToString() + "\n";
  EXPECT_THAT(problems, ::testing::HasSubstr("bracket.speed_m_s: 0, expected the speed"));
  EXPECT_THAT(problems,
              ::testing::HasSubstr("bracket.frames_per_position: 2, expected 1 or the 3"));
  EXPECT_THAT(problems, ::testing::HasSubstr("bracket.order: \"triangle\", expected"));
}

TEST(Config, ACameraOnTheTriggersWireNeedsALineThatObservesItAndOnePictureAPulse) {
  const auto problems = [](const std::string& text) {
    std::string all;
    for (const ConfigProblem& problem : ParseConfig(text, "c.toml").problems) {
      all += problem.ToString() + "\n";
    }
    return all;
  };
  const std::string camera = "[camera]\ndriver = \"iidc\"\n[camera.iidc]\nrig = \"head.toml\"\n";
  const std::string line = "[gpio.trigger]\nchip = \"c\"\nline = \"1\"\n";
  EXPECT_EQ(problems(camera + line + "[trigger]\nsource = \"gpio\"\nwired = true\n"), "");
  EXPECT_THAT(problems(camera + "[trigger]\nsource = \"timer\"\nwired = true\n"),
              HasSubstr("trigger.source: expected \"gpio\""));
  EXPECT_THAT(
      problems("[camera]\ndriver = \"v4l2\"\n[trigger]\nwired = true\n"),
      HasSubstr("camera.driver: \"v4l2\", expected \"iidc\" or \"sim\" with trigger.wired = true: "
                "V4L2 cameras run freely"));
  EXPECT_THAT(problems("[camera]\ndriver = \"replay\"\n[trigger]\nwired = true\n"),
              HasSubstr("camera.driver: expected \"iidc\" or \"sim\""));
  EXPECT_THAT(problems("[trigger]\nwired = true\nburst = true\n"), HasSubstr("trigger.burst"));
  EXPECT_EQ(problems("[trigger]\nsource = \"timer\"\nwired = true\n"), "")
      << "the simulated camera's pulses are any source's triggers";
}

TEST(Config, AMeteredBracketIsRefusedWhereItCannotBe) {
  EXPECT_THAT(OnlyProblem("bracket.meter = 'adopt'\ntrigger.burst = true\n"),
              HasSubstr("bracket.meter: \"adopt\", expected \"report\" or \"off\""));
  EXPECT_THAT(OnlyProblem("bracket.meter = 'report'\ntrigger.wired = true\n"),
              HasSubstr("expected \"off\" with trigger.wired"));
  EXPECT_TRUE(ParseConfig("bracket.meter = 'report'\ntrigger.burst = true\n", "c.toml").ok());
}

TEST(ConfigFile, OmnihdrTomlListsEveryKeyWithExactlyTheBuiltInDefault) {
  const LoadedConfig loaded = LoadConfig(kConfigFolder / "omnihdr.toml");
  for (const ConfigProblem& problem : loaded.problems) ADD_FAILURE() << problem.ToString();
  const DaemonConfig defaults;
  for (const std::string& key : ConfigKeyNames()) {
    EXPECT_TRUE(loaded.sources.contains(key)) << key << " is not in config/omnihdr.toml";
    EXPECT_EQ(Value(loaded.config, key), Value(defaults, key)) << key;
  }
}

TEST(ConfigFile, OmnihdrTomlHasTheKeysInTheOrderOfTheTableAndACommentForEach) {
  const Result<std::string> text = ReadTextFile(kConfigFolder / "omnihdr.toml");
  ASSERT_TRUE(text);
  std::vector<std::string> keys;
  std::string section;
  bool explained = false;
  std::istringstream lines(*text);
  for (std::string line; std::getline(lines, line);) {
    EXPECT_LE(line.size(), 110U) << line;
    if (line.starts_with("#")) {
      explained = true;
    } else if (line.starts_with("[")) {
      section = line.substr(1, line.size() - 2);
      explained = false;
    } else if (const std::size_t equals = line.find(" = "); equals != std::string::npos) {
      keys.push_back(section + "." + line.substr(0, equals));
      EXPECT_TRUE(explained) << "no comment above " << keys.back();
    } else {
      EXPECT_TRUE(line.empty()) << line;
      explained = false;
    }
  }
  EXPECT_EQ(keys, ConfigKeyNames());
}

TEST(ConfigFile, DemoTomlIsTheDemonstrationsVehicle) {
  const LoadedConfig loaded = LoadConfig(kConfigFolder / "demo.toml");
  for (const ConfigProblem& problem : loaded.problems) ADD_FAILURE() << problem.ToString();
  const DaemonConfig& config = loaded.config;
  EXPECT_EQ(config.camera.driver, CameraDriver::kSim);
  EXPECT_EQ(config.camera.sim.scene, SimScene::kHall);
  EXPECT_EQ(config.camera.sim.width, 1536);
  EXPECT_EQ(config.trigger.source, TriggerKind::kDistance);
  EXPECT_EQ(config.trigger.distance_m, 0.3);
  EXPECT_EQ(config.trigger.limit, 9U);
  const std::vector<ExposureTime> exposures = config.bracket.Exposures();
  ASSERT_EQ(exposures.size(), 3U);
  EXPECT_NEAR((exposures[1] - exposures[0]).value, 1.6, 1e-12);
  EXPECT_NEAR((exposures[2] - exposures[1]).value, 1.6, 1e-12);
}

TEST(ConfigFile, ThesisTomlIsTheThesisOfThePipelineOptions) {
  const LoadedConfig loaded = LoadConfig(kConfigFolder / "thesis.toml");
  for (const ConfigProblem& problem : loaded.problems) ADD_FAILURE() << problem.ToString();
  DaemonConfig expected;
  expected.pipeline.options = PipelineOptions::Thesis();
  for (const std::string& key : ConfigKeyNames()) {
    EXPECT_EQ(Value(loaded.config, key), Value(expected, key)) << key;
  }
}

TEST(Config, AStereoMethodThatDoesNotExistIsRefusedWithThoseThatDo) {
  const LoadedConfig loaded = ParseConfig("[stereo]\ncost = \"ncc\"\n", "omnihdr.toml");
  ASSERT_EQ(loaded.problems.size(), 1U);
  const std::string text = loaded.problems[0].ToString();
  EXPECT_NE(text.find("stereo.cost"), std::string::npos) << text;
  EXPECT_NE(text.find("\"interval\", \"radiometric\", \"census\" or \"mutual-information\""),
            std::string::npos)
      << text;
}

TEST(Config, AnEmptyFileGivesTheDefaults) {
  const LoadedConfig loaded = ParseConfig("", "omnihdr.toml");
  EXPECT_TRUE(loaded.ok());
  EXPECT_TRUE(loaded.sources.empty());
  for (const std::string& key : ConfigKeyNames()) {
    EXPECT_EQ(Value(loaded.config, key), Value(DaemonConfig{}, key)) << key;
  }
}

TEST(Config, EveryKeyCanBeSetToAValueThatConfigShowPrints) {
  // What `config show` prints is itself a configuration with the same values.
  const LoadedConfig first = ParseConfig(
      "[camera]\ndriver = 'replay'\nreplay.session = '/data/one'\n[log]\nlevel = 'debug'\n"
      "[bracket]\nexposures_s = [0.25, 0.5]\n[api]\nsocket_mode = '0600'\n",
      "/etc/x.toml");
  ASSERT_TRUE(first.ok());
  const std::string shown = FormatConfig(first);
  const LoadedConfig second = ParseConfig(shown, "/etc/y.toml");
  for (const ConfigProblem& problem : second.problems) ADD_FAILURE() << problem.ToString();
  for (const std::string& key : ConfigKeyNames()) {
    EXPECT_TRUE(second.sources.contains(key)) << key;
    EXPECT_EQ(Value(second.config, key), Value(first.config, key)) << key;
  }
  EXPECT_EQ(second.config.log.level, LogLevel::kDebug);
  EXPECT_EQ(second.config.api.socket_mode, 0600U);
}

TEST(Config, EveryKeyRefusesAnotherType) {
  for (const std::string& key : ConfigKeyNames()) {
    const std::string wrong = OnlyProblem(key + " = 1979-05-27\n");
    EXPECT_THAT(wrong, HasSubstr("dir/test.toml:1: " + key + ": a date or time, expected ")) << key;
    const std::string section = OnlyProblem("[" + key + "]\nx = 1\n");
    EXPECT_THAT(section, HasSubstr("dir/test.toml:1: " + key + ": a section, expected ")) << key;
  }
}

TEST(Config, AnUnknownKeyIsAnErrorThatNamesTheLikelyOne) {
  EXPECT_EQ(OnlyProblem("[camera]\nframe_timout_s = 2.0\n"),
            "dir/test.toml:2: camera.frame_timout_s: 2.0, expected a known key (did you mean "
            "camera.frame_timeout_s?)");
  EXPECT_EQ(OnlyProblem("level = 'info'\n"),
            "dir/test.toml:1: level: \"info\", expected a known key (did you mean log.level?)");
  EXPECT_EQ(OnlyProblem("[log]\ncolour_of_the_sky = 1\n"),
            "dir/test.toml:2: log.colour_of_the_sky: 1, expected a known key");
  EXPECT_EQ(
      OnlyProblem("\"log.level\" = 'info'\n"),
      "dir/test.toml:1: \"log.level\": \"info\", expected a known key (did you mean log.level?)");
}

TEST(Config, AnUnknownSectionIsReportedOnce) {
  EXPECT_EQ(OnlyProblem("[wheels]\nfront = 2\nback = 2\n[wheels.spare]\nx = 1\n"),
            "dir/test.toml:1: wheels: unknown section");
  EXPECT_EQ(OnlyProblem("log = 'info'\n"),
            "dir/test.toml:1: log: \"info\", expected a section [log]");
  EXPECT_EQ(OnlyProblem("[[camera]]\ndriver = 'sim'\n[[camera]]\n[camera.sim]\n"),
            "dir/test.toml:1: camera: a list [[camera]], expected a section [camera]");
}

TEST(Config, OutOfRangeNamesKeyValueAndRange) {
  EXPECT_EQ(OnlyProblem("[camera]\nframe_timeout_s = -1\n"),
            "dir/test.toml:2: camera.frame_timeout_s: -1, expected seconds in [0.01, 600]");
  EXPECT_EQ(OnlyProblem("[camera]\nframe_timeout_s = nan\n"),
            "dir/test.toml:2: camera.frame_timeout_s: nan, expected seconds in [0.01, 600]");
  EXPECT_EQ(OnlyProblem("[camera]\nframe_timeout_s = inf\n"),
            "dir/test.toml:2: camera.frame_timeout_s: inf, expected seconds in [0.01, 600]");
  EXPECT_EQ(OnlyProblem("[camera.sim]\nwidth = 1537\n"),
            "dir/test.toml:2: camera.sim.width: 1537, expected an even number of pixels in [128, "
            "8192]");
  EXPECT_EQ(
      OnlyProblem("[camera.sim]\nscene = 'moon'\n"),
      "dir/test.toml:2: camera.sim.scene: \"moon\", expected \"hall\", \"yard\", \"tunnel\" or "
      "\"street\"");
  EXPECT_EQ(
      OnlyProblem("[api]\nsocket_mode = \"660\"\n"),
      "dir/test.toml:2: api.socket_mode: \"660\", expected three octal digits after a 0, such "
      "as \"0660\"");
  EXPECT_EQ(OnlyProblem("[api]\nsocket_mode = 0o660\n"),
            "dir/test.toml:2: api.socket_mode: 432, expected three octal digits after a 0, such as "
            "\"0660\"");
  EXPECT_THAT(OnlyProblem("[bracket]\nexposures_s = [0.1, 0.0]\n"),
              HasSubstr("bracket.exposures_s: [0.1, 0.0], expected an array of at most 64"));
  EXPECT_THAT(OnlyProblem("[bracket]\nexposures_s = [0.1, 'x']\n"), HasSubstr("[0.1, \"x\"]"));
  EXPECT_THAT(OnlyProblem("[session]\nname = '../up'\n"), HasSubstr("session.name: \"../up\""));
  EXPECT_THAT(OnlyProblem("[session]\ndirectory = ''\n"), HasSubstr("expected a directory"));
  EXPECT_THAT(OnlyProblem("[api]\nsocket = '/" + std::string(107, 's') + "'\n"),
              HasSubstr("at most 107 bytes"));
}

TEST(Config, AWholeNumberIsAcceptedForARealOneButNotTheReverse) {
  EXPECT_EQ(ParseConfig("camera.frame_timeout_s = 3", "x").config.camera.frame_timeout_s, 3.0);
  EXPECT_EQ(OnlyProblem("stereo.labels = 64.0"),
            "dir/test.toml:1: stereo.labels: 64.0, expected a whole number in [16, 256]");
}

TEST(Config, AllProblemsAreReportedInOrderAndGoodKeysStillCount) {
  const LoadedConfig loaded = ParseConfig(
      "[log]\nlevel = 'loud'\n[camera]\ndriver = 5\nreconnect_s = 7.0\n[stereo]\nlabel = 1\n",
      "c.toml");
  ASSERT_EQ(loaded.problems.size(), 3U);
  EXPECT_EQ(loaded.problems[0].line, 2);
  EXPECT_EQ(loaded.problems[1].line, 4);
  EXPECT_EQ(loaded.problems[2].line, 7);
  EXPECT_EQ(loaded.config.camera.reconnect_s, 7.0);
  const Result<DaemonConfig> result = ConfigOrError(loaded);
  ASSERT_FALSE(result);
  EXPECT_EQ(ExitCode(result.error().kind), 78);
  EXPECT_THAT(result.error().message, HasSubstr("c.toml:2: log.level: \"loud\", expected"));
  EXPECT_THAT(result.error().message,
              HasSubstr("\nc.toml:7: stereo.label: 1, expected a known key"));
}

TEST(Config, TextThatIsNotTomlNamesTheLine) {
  EXPECT_THAT(OnlyProblem("[log]\nlevel = \n"), HasSubstr("dir/test.toml:2: column "));
  EXPECT_THAT(OnlyProblem("[log]\nlevel = 'info'\nlevel = 'debug'\n"),
              HasSubstr("dir/test.toml:3: "));
  EXPECT_THAT(OnlyProblem("# caf\xE9\n"), HasSubstr("dir/test.toml:1: byte 0xe9, expected UTF-8"));
  EXPECT_THAT(OnlyProblem(std::string("\n\0", 2)), HasSubstr("dir/test.toml:2: byte 0x00"));
  EXPECT_THAT(OnlyProblem("x = " + std::string(5000, '[')), HasSubstr("dir/test.toml:1: column "));
  EXPECT_THAT(OnlyProblem(std::string((1U << 20U) + 1, '#')),
              HasSubstr("expected at most 1048576"));
}

TEST(Config, CharactersBeyondAsciiBelongInQuotesAndComments) {
  EXPECT_THAT(OnlyProblem("# \xC3\xA9\n\xC8\x8C = 1\n"),
              AllOf(HasSubstr("dir/test.toml:2: column 1: "), HasSubstr("beyond ASCII")));
  EXPECT_THAT(OnlyProblem("log.level = 'info' \xC3\xA9\n"), HasSubstr("test.toml:1: column 20: "));
  EXPECT_THAT(OnlyProblem("input.mask = '\xC3\xA9\xC3\xA9' x\n"),
              HasSubstr("test.toml:1: column 19"));
  EXPECT_THAT(OnlyProblem("~ = 1\n"), AllOf(HasSubstr("column 1: "), HasSubstr("'~'")));
  struct Case {
    std::string toml;
    std::string value;
  };
  for (const Case& c :
       std::vector<Case>{{"\"/\xC3\xA9\"", "/\xC3\xA9"},
                         {"'/\xC3\xA9~~7E~'", "/\xC3\xA9~~7E~"},
                         {"\"\"\"/a\\\n\xC3\xA9\"\"\"\"\"", "/a\xC3\xA9\"\""},
                         {"'''/\xF0\x9F\x98\x80'''", "/\xF0\x9F\x98\x80"},
                         {"\"/\\\"\xC3\xA9\\\\\\u00e9\" # \xC3\xA9", "/\"\xC3\xA9\\\xC3\xA9"}}) {
    const LoadedConfig loaded =
        ParseConfig("input.mask = " + c.toml + "\nlog.level = 'debug'\n", "x");
    EXPECT_TRUE(loaded.ok()) << c.toml << (loaded.ok() ? "" : loaded.problems[0].ToString());
    EXPECT_EQ(loaded.config.pipeline.options.mask_file, c.value);
    EXPECT_EQ(loaded.config.log.level, LogLevel::kDebug) << c.toml;
  }
  EXPECT_THAT(OnlyProblem("\ninput.mask = \"\\u007e41\""),
              HasSubstr("dir/test.toml:2: \"~\" as an escape, expected the character itself"));
  EXPECT_THAT(OnlyProblem("\"k\xC3\xA9y\" = 1\n"),
              HasSubstr(": \"k\xC3\xA9y\": 1, expected a known"));
}

TEST(Config, ShortMalformedTextsAreErrorsAndNothingWorse) {
  // Every text of up to two bytes, and of three from the characters that mean something in TOML.
  const std::string letters = "[]{}=\"'\\\n\r\t #.,:+-_0eaux\xEF\xBB\xBF\xC3\x80";
  std::vector<std::string> texts;
  for (int a = 0; a < 256; ++a) {
    texts.emplace_back(1, static_cast<char>(a));
    for (const char b : letters) texts.push_back({static_cast<char>(a), b});
  }
  for (const char a : letters) {
    for (const char b : letters) {
      for (const char c : letters) texts.push_back({a, b, c});
    }
  }
  for (const std::string& text : texts) {
    const LoadedConfig loaded = ParseConfig(text, "t");
    for (const ConfigProblem& problem : loaded.problems) EXPECT_FALSE(problem.message.empty());
  }
}

TEST(Config, PrimariesAreEightNumbersAroundTheirWhite) {
  const LoadedConfig loaded = ParseConfig(
      "output.chromaticities = [0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 1]\n", "x");
  EXPECT_FALSE(loaded.ok());  // white outside
  const LoadedConfig rec2020 = ParseConfig(
      "output.chromaticities = [0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329]\n", "x");
  ASSERT_TRUE(rec2020.ok());
  EXPECT_EQ(rec2020.config.pipeline.options.chromaticities[3], 0.797);
  for (const char* text : {"[]", "[1, 2, 3]", "0.3", "\"rec709\"", "[true, 0, 0, 0, 0, 0, 0, 0]",
                           "[0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329, 0.1]"}) {
    EXPECT_NE(OnlyProblem(fmt::format("output.chromaticities = {}\n", text))
                  .find("expected an array of 8 numbers from -1 to 2"),
              std::string::npos)
        << text;
  }
}

TEST(Config, WhatItAcceptsThePipelineAccepts) {
  const std::regex range(R"(in \[([-+.e0-9]+), ([-+.e0-9]+)\])");
  int checked = 0;
  for (const std::string& key : ConfigKeyNames()) {
    const std::string section = key.substr(0, key.find('.'));
    if (!std::set<std::string>{"output", "photometry", "stereo", "pose", "merge"}.contains(
            section)) {
      continue;
    }
    const std::string problem = OnlyProblem(key + " = 1979-05-27\n");
    std::smatch match;
    if (!std::regex_search(problem, match, range)) continue;
    for (const std::string& bound : {match[1].str(), match[2].str()}) {
      const LoadedConfig loaded = ParseConfig(fmt::format("{} = {}\n", key, bound), "x");
      EXPECT_TRUE(loaded.ok()) << key << " = " << bound;
      const Status valid = loaded.config.pipeline.options.Validate();
      EXPECT_TRUE(valid) << key << " = " << bound << ": " << valid.error().message;
      ++checked;
    }
  }
  EXPECT_GE(checked, 20);
}

TEST(Config, HowMosaicsAreInterpolatedIsNamed) {
  EXPECT_EQ(ParseConfig("", "x").config.pipeline.options.demosaic, Demosaic::kBilinear);
  const LoadedConfig loaded = ParseConfig("stitch.demosaic = \"edge-aware\"\n", "x");
  ASSERT_TRUE(loaded.ok());
  EXPECT_EQ(loaded.config.pipeline.options.demosaic, Demosaic::kEdgeAware);
  EXPECT_THAT(OnlyProblem("stitch.demosaic = \"vng\"\n"),
              HasSubstr("expected \"bilinear\" or \"edge-aware\""));
}

TEST(Config, ABracketGivenBothWaysInOneFileIsAnError) {
  EXPECT_THAT(OnlyProblem("[bracket]\nexposures_s = [0.1]\nstart_s = 0.001\n"),
              HasSubstr("dir/test.toml:3: bracket.start_s: 0.001, expected either "
                        "bracket.exposures_s or bracket.start_s, not both"));
  EXPECT_THAT(OnlyProblem("[bracket]\nexposures_s = []\n"), HasSubstr("expected at least one"));
  EXPECT_THAT(
      OnlyProblem("[bracket]\norder = 'triangle'\nexposures_s = [0.1, 0.2, 0.1]\n"),
      HasSubstr("dir/test.toml:3: bracket.exposures_s: [0.1, 0.2, 0.1], expected no exposure "
                "twice unless bracket.order = \"list\""));
  EXPECT_TRUE(
      ParseConfig("[bracket]\norder = 'list'\nexposures_s = [0.1, 0.2, 0.1, 0.3]\n", "x").ok());
}

TEST(Config, TheBracketInStepsIsAGeometricSeries) {
  const LoadedConfig loaded =
      ParseConfig("[bracket]\nstart_s = 0.001\nstep_stops = 2.0\ncount = 4\n", "x.toml");
  ASSERT_TRUE(loaded.ok());
  std::vector<double> seconds;
  for (const ExposureTime exposure : loaded.config.bracket.Exposures()) {
    seconds.push_back(exposure.seconds());
  }
  EXPECT_EQ(seconds, (std::vector<double>{0.001, 0.004, 0.016, 0.064}));
  EXPECT_THAT(
      OnlyProblem("[bracket]\nstart_s = 1.0\nstep_stops = 5.0\ncount = 3\n"),
      HasSubstr("bracket.count: 3, expected the longest exposure, now 1024 s, within 100 s"));
}

TEST(Config, KeysThatNeedEachOtherAreCheckedTogether) {
  EXPECT_THAT(OnlyProblem("camera.driver = 'replay'\n"),
              HasSubstr("dir/test.toml:1: camera.replay.session: \"\", expected a session"));
  EXPECT_THAT(OnlyProblem("camera.driver = 'iidc'\n"),
              HasSubstr("dir/test.toml:1: camera.iidc.rig: \"\", expected the rig file"));
  EXPECT_THAT(OnlyProblem("[camera.iidc]\nformat = 'jpeg'\nexposure_cycle = 'on'\n"),
              HasSubstr("dir/test.toml:3: camera.iidc.exposure_cycle: \"on\", expected \"auto\""));
  EXPECT_THAT(OnlyProblem("camera.driver = 'v4l2'\n"),
              HasSubstr("dir/test.toml:1: camera.v4l2.rig: \"\", expected the rig file"));
  EXPECT_THAT(
      OnlyProblem("camera.driver = 'v4l2'\n[camera.v4l2]\nlayout = 'panorama'\nwidth = 64\n"),
      HasSubstr("dir/test.toml:4: camera.v4l2.width: 64, expected it and camera.v4l2.height"));
  EXPECT_THAT(OnlyProblem("camera.driver = 'v4l2'\n[camera.v4l2]\nrig = 'a.toml'\ndevice = 'x'\n"
                          "devices = ['a', 'b']\n"),
              HasSubstr("dir/test.toml:5: camera.v4l2.devices: device, controls: \"x\", \"\": "
                        "expected \"\" with devices"));
  EXPECT_THAT(OnlyProblem("camera.v4l2.devices = ['a']\n"), HasSubstr("an array of 2 to 16"));
  EXPECT_THAT(OnlyProblem("camera.v4l2.white_balance = 20\n"),
              HasSubstr("kelvin in [1000, 20000]"));
  EXPECT_THAT(OnlyProblem("trigger.source = 'replay'\n"), HasSubstr("trigger.source: \"replay\""));
  EXPECT_THAT(OnlyProblem("bracket.order = 'list'\nbracket.start_s = 0.01\n"),
              HasSubstr("bracket.order: \"list\", expected"));
}

TEST(Config, RelativePathsAreTakenFromTheFilesDirectory) {
  const LoadedConfig loaded =
      ParseConfig("[session]\ndirectory = 'data/../sessions'\n[input]\nmask = '/abs/mask.png'\n",
                  "/etc/o/x.toml");
  EXPECT_EQ(loaded.config.session.directory, "/etc/o/sessions");
  EXPECT_EQ(loaded.config.pipeline.options.mask_file, "/abs/mask.png");
  EXPECT_EQ(ParseConfig("input.mask = 'm.png'", "x.toml").config.pipeline.options.mask_file,
            "m.png");
}

TEST(ConfigDropIns, OverrideKeyByKeyInLexicalOrder) {
  const TemporaryDirectory directory;
  directory.Write("omnihdr.toml", "[trigger]\nlimit = 1\ninterval_s = 5\n[stereo]\nlabels = 64\n");
  directory.Write("omnihdr.d/20-b.toml", "trigger.limit = 3\n");
  directory.Write("omnihdr.d/10-a.toml", "trigger.limit = 2\nstereo.labels = 32\n");
  directory.Write("omnihdr.d/.hidden.toml", "trigger.limit = 9\n");
  directory.Write("omnihdr.d/30-c.toml~", "trigger.limit = 9\n");
  const LoadedConfig loaded = LoadConfig(directory.path() / "omnihdr.toml");
  ASSERT_TRUE(loaded.ok());
  EXPECT_EQ(loaded.config.trigger.limit, 3U);
  EXPECT_EQ(loaded.config.pipeline.options.labels, 32);
  EXPECT_EQ(loaded.config.trigger.interval_s, 5.0);
  EXPECT_EQ(loaded.files, (std::vector<std::string>{directory.path() / "omnihdr.toml",
                                                    directory.path() / "omnihdr.d/10-a.toml",
                                                    directory.path() / "omnihdr.d/20-b.toml"}));
  EXPECT_EQ(loaded.sources.at("trigger.limit").file, directory.path() / "omnihdr.d/20-b.toml");
  EXPECT_EQ(loaded.sources.at("trigger.interval_s").line, 3);
}

TEST(ConfigDropIns, TheBracketFormGivenLastReplacesTheOther) {
  const TemporaryDirectory directory;
  directory.Write("omnihdr.toml", "[bracket]\nexposures_s = [0.1, 0.2]\n");
  directory.Write("omnihdr.d/1.toml", "[bracket]\nstart_s = 0.001\ncount = 5\n");
  LoadedConfig loaded = LoadConfig(directory.path() / "omnihdr.toml");
  ASSERT_TRUE(loaded.ok());
  EXPECT_EQ(loaded.config.bracket.Exposures().size(), 5U);
  directory.Write("omnihdr.d/2.toml", "[bracket]\nexposures_s = [0.3]\n");
  loaded = LoadConfig(directory.path() / "omnihdr.toml");
  ASSERT_TRUE(loaded.ok());
  EXPECT_EQ(loaded.config.bracket.Exposures(),
            std::vector<ExposureTime>{ExposureTime::Seconds(0.3)});
}

TEST(ConfigDropIns, AProblemNamesTheDropInAndAllFilesAreChecked) {
  const TemporaryDirectory directory;
  directory.Write("omnihdr.toml", "[log]\nlevel = 'loud'\n");
  directory.Write("omnihdr.d/1.toml", "\nwhat = 1\n");
  fs::create_directories(directory.path() / "omnihdr.d/2.toml");
  const LoadedConfig loaded = LoadConfig(directory.path() / "omnihdr.toml");
  ASSERT_EQ(loaded.problems.size(), 3U);
  EXPECT_EQ(loaded.problems[1].file, directory.path() / "omnihdr.d/1.toml");
  EXPECT_EQ(loaded.problems[1].line, 2);
  EXPECT_EQ(loaded.problems[2].file, directory.path() / "omnihdr.d/2.toml");
  EXPECT_THAT(loaded.problems[2].message, HasSubstr("not a regular file"));
}

TEST(ConfigDropIns, AMissingMainFileIsAProblemOnlyWhenItMustExist) {
  const TemporaryDirectory directory;
  directory.Write("omnihdr.d/1.toml", "trigger.limit = 2\n");
  const LoadedConfig strict = LoadConfig(directory.path() / "omnihdr.toml");
  ASSERT_EQ(strict.problems.size(), 1U);
  EXPECT_EQ(strict.problems[0].ToString(),
            (directory.path() / "omnihdr.toml").string() + ": No such file or directory");
  const LoadedConfig lenient = LoadConfig(directory.path() / "omnihdr.toml", false);
  EXPECT_TRUE(lenient.ok());
  EXPECT_EQ(lenient.config.trigger.limit, 2U);
}

TEST(ConfigShow, JsonHoldsEveryKeyWithValueAndSource) {
  const LoadedConfig loaded =
      ParseConfig("\n[session]\nname = \"a\\\"b\\u00e9\"\n[stereo]\nlabels = 64\n", "/o.toml");
  ASSERT_TRUE(loaded.ok());
  const nlohmann::json json = nlohmann::json::parse(FormatConfigJson(loaded));
  EXPECT_EQ(json["files"], nlohmann::json({"/o.toml"}));
  const nlohmann::json& values = json["values"];
  EXPECT_EQ(values.size(), ConfigKeyNames().size());
  EXPECT_EQ(values["session.name"]["value"], "a\"b\u00e9");
  EXPECT_EQ(values["session.name"]["source"], "/o.toml:3");
  EXPECT_EQ(values["stereo.labels"]["value"], 64);
  EXPECT_EQ(values["camera.sim.width"]["source"], "default");
}

}  // namespace
}  // namespace omnihdr::config_test
