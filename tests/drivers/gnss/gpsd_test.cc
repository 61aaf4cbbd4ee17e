#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <thread>

#include "core/base/tcp.h"
#include "drivers/gnss/gpsd_client.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::gpsd_test {
namespace {

using ::testing::HasSubstr;
using ::testing::MatchesRegex;

bool Eventually(const std::function<bool()>& condition, int seconds = 5) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(seconds);
  while (std::chrono::steady_clock::now() < deadline) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return condition();
}

constexpr const char* kGreeting =
    "{\"class\":\"VERSION\",\"release\":\"3.22\",\"rev\":\"3.22\",\"proto_major\":3,"
    "\"proto_minor\":14}";

std::string Tpv(const std::string& members) {
  return "{\"class\":\"TPV\",\"device\":\"/dev/ttyS0\"," + members + "}";
}

std::optional<gnss::Report> Parse(const std::string& line) {
  gnss::ReportParser parser;
  return parser.Parse(line, HostTime::FromNanoseconds(0));
}

TEST(GpsdReports, AFixHasItsPlaceTimeAndQuality) {
  const auto report =
      Parse(Tpv("\"status\":3,\"mode\":3,\"time\":\"2026-01-01T12:00:13.250Z\",\"ept\":0.005,"
                "\"lat\":52.500216667,\"lon\":-13.4,\"altHAE\":86.5,\"altMSL\":40.5,\"track\":45.5,"
                "\"speed\":4.99,\"eph\":0.02"));
  ASSERT_TRUE(report && report->fix);
  EXPECT_NEAR(report->fix->lat_deg, 52.500216667, 1e-12);
  EXPECT_EQ(report->fix->lon_deg, -13.4);
  EXPECT_EQ(report->fix->alt_m, 40.5);
  EXPECT_EQ(report->fix->dimensions, 3);
  EXPECT_EQ(report->fix->fix, 4);  // RTK fixed, as NMEA GGA counts
  EXPECT_EQ(report->fix->time, "2026-01-01T12:00:13.250Z");
  EXPECT_EQ(report->fix->time_source, "gnss");
  EXPECT_EQ(report->fix->time_error_s, 0.005);
  EXPECT_EQ(report->fix->error_m, 0.02);
  EXPECT_EQ(report->track_deg, 45.5);
  EXPECT_EQ(report->speed_m_s, 4.99);
}

TEST(GpsdReports, AReceiverWithoutAFixReportsNone) {
  const auto report = Parse(Tpv("\"mode\":1,\"time\":\"2026-01-01T12:00:13.000Z\""));
  ASSERT_TRUE(report);
  EXPECT_FALSE(report->fix);
}

TEST(GpsdReports, AFixWithoutHeightSaysSoAndAPlainOneIsOfQuality1) {
  const auto report = Parse(Tpv("\"mode\":2,\"lat\":1.5,\"lon\":2.5,\"altMSL\":99.0"));
  ASSERT_TRUE(report && report->fix);
  EXPECT_EQ(report->fix->dimensions, 2);
  EXPECT_EQ(report->fix->alt_m, 0.0);
  EXPECT_EQ(report->fix->fix, 1);
  EXPECT_EQ(report->fix->time, "");
  EXPECT_FALSE(report->fix->error_m);
}

TEST(GpsdReports, ValuesOfOneReportDoNotStayForTheNext) {
  gnss::ReportParser parser;
  const HostTime now = HostTime::FromNanoseconds(0);
  ASSERT_TRUE(
      parser.Parse(Tpv("\"mode\":3,\"lat\":1.5,\"lon\":2.5,\"altMSL\":9,\"track\":5"), now));
  const auto next = parser.Parse(Tpv("\"mode\":2,\"lat\":1.5,\"lon\":2.5"), now);
  ASSERT_TRUE(next && next->fix);
  EXPECT_FALSE(next->track_deg);
  EXPECT_EQ(next->fix->alt_m, 0.0);
}

// Lines of a gpsd to come, which stop libgps 3.22 for ever.
TEST(GpsdReports, MembersThatNobodyKnowsAreSkippedOver) {
  gnss::ReportParser parser;
  const HostTime now = HostTime::FromNanoseconds(0);
  EXPECT_FALSE(parser.Parse(
      R"({"class":"DEVICES","devices":[{"class":"DEVICE","path":"a","extra":{"b":1}}]})", now));
  EXPECT_EQ(parser.errors(), 0U);
  const auto report =
      parser.Parse(Tpv(R"("mode":2,"lat":1.5,"lon":2.5,"x":[{"class":"DEVICE","path":"a"}])"), now);
  ASSERT_TRUE(report && report->fix);
  EXPECT_EQ(report->fix->lat_deg, 1.5);
}

TEST(GpsdReports, PulsesPerSecondMakeTheTimesSourceBetterForThreeSeconds) {
  gnss::ReportParser parser;
  const std::string tpv =
      Tpv("\"mode\":2,\"lat\":1.5,\"lon\":2.5,\"time\":\"2026-01-01T12:00:13.000Z\"");
  EXPECT_FALSE(parser.Parse("{\"class\":\"PPS\",\"device\":\"/dev/pps0\"}",
                            HostTime::FromNanoseconds(1'000'000'000)));
  EXPECT_EQ(parser.Parse(tpv, HostTime::FromNanoseconds(2'000'000'000))->fix->time_source,
            "gnss+pps");
  EXPECT_EQ(parser.Parse(tpv, HostTime::FromNanoseconds(5'000'000'000))->fix->time_source, "gnss");
}

TEST(GpsdReports, WhatIsNotUnderstoodIsCountedAndNothingElse) {
  gnss::ReportParser parser;
  const HostTime now = HostTime::FromNanoseconds(0);
  for (const char* line :
       {"garbage", "{}", "{\"class\":\"TPV\"", "{\"class\":\"TPV\",\"mode\":\"x\"}",
        "{\"class\":\"TPV\",\"mode\":[[[[", "\x01\xff"}) {
    EXPECT_FALSE(parser.Parse(line, now)) << line;
  }
  EXPECT_EQ(parser.errors(), 6U);
  EXPECT_FALSE(parser.Parse("{\"class\":\"SKY\",\"satellites\":[]}", now));
  EXPECT_EQ(parser.errors(), 6U);
  // Out of the world is nowhere.
  const auto nowhere = parser.Parse(Tpv("\"mode\":3,\"lat\":95.0,\"lon\":2.5"), now);
  ASSERT_TRUE(nowhere);
  EXPECT_FALSE(nowhere->fix);
}

TEST(GpsdLines, AreWholeHoweverTheyCameAndOneThatIsTooLongIsLeftOut) {
  gnss::LineCutter lines;
  lines.Add("first\r\nsec");
  EXPECT_EQ(lines.Next(), "first");
  EXPECT_FALSE(lines.Next());
  lines.Add("ond\n");
  EXPECT_EQ(lines.Next(), "second");
  for (int i = 0; i < 10; ++i) {
    lines.Add(std::string(4096, 'x'));
    EXPECT_FALSE(lines.Next());
  }
  lines.Add("\nlast\n");
  EXPECT_EQ(lines.Next(), "last");
  EXPECT_EQ(lines.too_long(), 1U);
}

// A gpsd of the test's own: what it says, and when, the test decides.
struct FakeGpsd {
  Fd listener = std::move(*ListenTcp("127.0.0.1", 0));
  int port = LocalPort(listener.get());
  Fd client;
  bool Accept() {
    return Eventually([this] {
      client = Fd(accept(listener.get(), nullptr, nullptr));
      return client.valid();
    });
  }
  void Say(const std::string& line) const {
    const std::string text = line + "\r\n";
    ASSERT_EQ(send(client.get(), text.data(), text.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(text.size()));
  }
};

gnss::GpsdOptions Options(int port) {
  gnss::GpsdOptions options;
  options.port = port;
  options.reconnect_s = 0.2;
  return options;
}

TEST(GpsdClient, AFixCountsUntilItIsTooOldOrTheReceiverLosesIt) {
  FakeGpsd gpsd;
  const SystemClock clock;
  gnss::GpsdOptions options = Options(gpsd.port);
  options.max_age_s = 0.3;
  gnss::GpsdClient client(options, clock);
  ASSERT_TRUE(client.Start());
  ASSERT_TRUE(gpsd.Accept());
  gpsd.Say(kGreeting);
  const HostTime before = clock.Now();
  gpsd.Say(Tpv("\"mode\":3,\"lat\":1.5,\"lon\":2.5,\"altMSL\":9"));
  ASSERT_TRUE(Eventually([&] { return client.Fix(clock.Now()).has_value(); }));
  EXPECT_FALSE(client.Fix(before)) << "a fix of the future is none of the past";
  EXPECT_LT(*client.Fix(clock.Now())->age_s, 0.3);
  gpsd.Say(Tpv("\"mode\":1"));
  ASSERT_TRUE(Eventually([&] { return client.report().messages == 2; }));
  EXPECT_FALSE(client.Fix(clock.Now()));
  EXPECT_TRUE(client.report().up) << "no fix is no fault of the connection";
  gpsd.Say(Tpv("\"mode\":3,\"lat\":1.5,\"lon\":2.5,\"altMSL\":9"));
  ASSERT_TRUE(Eventually([&] { return client.Fix(clock.Now()).has_value(); }));
  ASSERT_TRUE(Eventually([&] { return !client.Fix(clock.Now()); }));
}

TEST(GpsdClient, TheCourseIsAHeadingWhenAskedForAndMoving) {
  FakeGpsd gpsd;
  const SystemClock clock;
  gnss::GpsdOptions options = Options(gpsd.port);
  options.track_heading = true;
  gnss::GpsdClient client(options, clock);
  ASSERT_TRUE(client.Start());
  ASSERT_TRUE(gpsd.Accept());
  gpsd.Say(Tpv("\"mode\":2,\"lat\":1,\"lon\":2,\"track\":271.5,\"speed\":3.0"));
  ASSERT_TRUE(Eventually([&] { return client.HeadingDeg(clock.Now()) == 271.5; }));
  gpsd.Say(Tpv("\"mode\":2,\"lat\":1,\"lon\":2,\"track\":12.0,\"speed\":0.2"));
  ASSERT_TRUE(Eventually([&] { return !client.HeadingDeg(clock.Now()); }));
}

TEST(GpsdClient, ItComesBackAfterAHangUpAndTellsWhatWasWrong) {
  FakeGpsd gpsd;
  const SystemClock clock;
  gnss::GpsdClient client(Options(gpsd.port), clock);
  ASSERT_TRUE(client.Start());
  ASSERT_TRUE(gpsd.Accept());
  gpsd.client.Close();
  ASSERT_TRUE(Eventually([&] { return client.report().errors > 0; }));
  EXPECT_THAT(client.report().problem, HasSubstr("gpsd 127.0.0.1:"));
  ASSERT_TRUE(gpsd.Accept());
  gpsd.Say(Tpv("\"mode\":2,\"lat\":1,\"lon\":2"));
  ASSERT_TRUE(Eventually([&] { return client.Fix(clock.Now()).has_value(); }));
  EXPECT_EQ(client.report().opened, 2U);
  EXPECT_EQ(client.report().problem, "");
}

TEST(GpsdClient, ASilentGpsdAndWhatIsNoneAreToldApartAndTriedAgain) {
  FakeGpsd gpsd;
  const SystemClock clock;
  gnss::GpsdOptions options = Options(gpsd.port);
  options.silent_s = 0.3;
  gnss::GpsdClient client(options, clock);
  ASSERT_TRUE(client.Start());
  ASSERT_TRUE(gpsd.Accept());
  gpsd.Say(kGreeting);
  ASSERT_TRUE(
      Eventually([&] { return !client.report().problem.empty() && client.report().errors > 0; }));
  EXPECT_THAT(client.report().problem, HasSubstr("gpsd tells of no position"));
  ASSERT_TRUE(gpsd.Accept());
  gpsd.Say("SSH-2.0-OpenSSH");
  ASSERT_TRUE(
      Eventually([&] { return client.report().problem.find("or no gpsd") != std::string::npos; }));
}

TEST(GpsdClient, OptionsOutOfRangeAreNamed) {
  gnss::GpsdOptions options;
  options.address = "localhost";
  EXPECT_THAT(options.Validate().error().message, HasSubstr("address: \"localhost\""));
  options = {};
  options.max_age_s = 0.0;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("max_age_s: 0"));
}

// ---- a real gpsd, fed through a pseudo-terminal

std::string Sentence(const std::string& body) {
  unsigned sum = 0;
  for (const char c : body) sum ^= static_cast<unsigned char>(c);
  return fmt::format("${}*{:02X}\r\n", body, sum);
}

// A second of a receiver that drives north at 5 m/s from 52.5 N, 13.4 E.
std::string Second(int i) {
  const std::string time = fmt::format("12{:02}{:02}.00", i / 60 % 60, i % 60);
  const std::string place = fmt::format("52{:07.4f},N,01324.0000,E", 30.0 + i * 0.0027);
  return Sentence(fmt::format("GPRMC,{},A,{},9.7,000.5,010126,,,D", time, place)) +
         Sentence(fmt::format("GPGGA,{},{},2,09,0.9,40.0,M,46.0,M,,", time, place)) +
         Sentence("GPGSA,A,3,04,05,09,12,24,25,29,31,02,,,,1.6,0.9,1.3");
}

const char* InstalledGpsd() {
  for (const char* path : {"/usr/sbin/gpsd", "/usr/local/sbin/gpsd"}) {
    if (access(path, X_OK) == 0) return path;
  }
  return nullptr;
}

// A gpsd with a receiver that lives ten times too fast.
class RealGpsd {
 public:
  RealGpsd(const char* program, int port) {
    int master = -1;
    int slave = -1;
    std::array<char, 128> name{};
    if (openpty(&master, &slave, name.data(), nullptr, nullptr) != 0) return;
    receiver_ = Fd(master);
    line_ = Fd(slave);
    termios raw{};
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(master, F_SETFL, O_NONBLOCK);
    const std::string text = std::to_string(port);
    pid_ = fork();
    if (pid_ == 0) {
      const int null = open("/dev/null", O_RDWR);
      for (const int fd : {0, 1, 2}) dup2(null, fd);
      execl(program, program, "-N", "-n", "-b", "-S", text.c_str(), name.data(), nullptr);
      _exit(127);
    }
    feeder_ = std::jthread([this](std::stop_token stop) {
      for (int i = 0; !stop.stop_requested(); ++i) {
        const std::string text_of_second = Second(i);
        // What a gpsd that has gone does not read is lost, as a receiver would lose it.
        [[maybe_unused]] const ssize_t written =
            write(receiver_.get(), text_of_second.data(), text_of_second.size());
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
      }
    });
  }
  ~RealGpsd() {
    if (pid_ <= 0) return;
    kill(pid_, SIGTERM);
    int status = 0;
    if (Eventually([&] { return waitpid(pid_, &status, WNOHANG) == pid_; })) return;
    kill(pid_, SIGKILL);
    waitpid(pid_, &status, 0);
  }
  RealGpsd(const RealGpsd&) = delete;
  RealGpsd& operator=(const RealGpsd&) = delete;

 private:
  Fd receiver_;
  Fd line_;  // kept open: the line does not hang up before gpsd has opened it
  pid_t pid_ = -1;
  std::jthread feeder_;
};

// gpsd's own test program: a log of sentences for a gpsd that it starts.
constexpr const char* kGpsfake = "/usr/local/bin/gpsfake";

class FakedGpsd {
 public:
  FakedGpsd(const std::filesystem::path& log, int port) {
    std::ofstream sentences(log);
    for (int i = 0; i < 600; ++i) sentences << Second(i);
    sentences.close();
    const std::string text = std::to_string(port);
    pid_ = fork();
    if (pid_ == 0) {
      setpgid(0, 0);  // with the gpsd that it starts
      const int null = open("/dev/null", O_RDWR);
      for (const int fd : {0, 1, 2}) dup2(null, fd);
      execl("/usr/bin/python3", "python3", kGpsfake, "-q", "-n", "-c", "0.03", "-P", text.c_str(),
            log.c_str(), nullptr);
      _exit(127);
    }
  }
  ~FakedGpsd() {
    if (pid_ <= 0) return;
    kill(pid_, SIGINT);
    int status = 0;
    const bool ended = Eventually([&] { return waitpid(pid_, &status, WNOHANG) == pid_; });
    kill(-pid_, SIGKILL);
    if (!ended) waitpid(pid_, &status, 0);
  }
  FakedGpsd(const FakedGpsd&) = delete;
  FakedGpsd& operator=(const FakedGpsd&) = delete;

 private:
  pid_t pid_ = -1;
};

// A client that began before there was a gpsd, and the fixes it has once `start` has made one.
void ExpectFixesOnceStarted(const std::function<std::shared_ptr<void>(int port)>& start) {
  int port = 0;
  {
    const Result<Fd> free_port = ListenTcp("127.0.0.1", 0);
    ASSERT_TRUE(free_port);
    port = LocalPort(free_port->get());
  }
  const SystemClock clock;
  gnss::GpsdOptions options = Options(port);
  options.track_heading = true;
  gnss::GpsdClient client(options, clock);
  ASSERT_TRUE(client.Start());  // before there is a gpsd
  ASSERT_TRUE(Eventually([&] { return client.report().errors > 0; }));
  const std::shared_ptr<void> gpsd = start(port);
  ASSERT_TRUE(Eventually(
      [&] {
        const auto fix = client.Fix(clock.Now());
        return fix && fix->dimensions == 3 && fix->time_error_s;
      },
      60))
      << client.report().problem;
  const GnssFix fix = *client.Fix(clock.Now());
  EXPECT_NEAR(fix.lat_deg, 52.5, 0.02);
  EXPECT_NEAR(fix.lon_deg, 13.4, 1e-6);
  EXPECT_NEAR(fix.alt_m, 40.0, 1e-6);
  EXPECT_EQ(fix.fix, 2);  // differential
  EXPECT_THAT(fix.time, MatchesRegex("2026-01-01T12:0.:...000Z"));
  EXPECT_EQ(fix.time_source, "gnss");
  EXPECT_TRUE(fix.time_error_s.has_value());
  ASSERT_TRUE(Eventually([&] { return client.HeadingDeg(clock.Now()).has_value(); }, 20));
  EXPECT_NEAR(*client.HeadingDeg(clock.Now()), 0.5, 1e-6);
  // It drives north.
  EXPECT_TRUE(Eventually(
      [&] {
        const auto later = client.Fix(clock.Now());
        return later && later->lat_deg > fix.lat_deg + 1e-5;
      },
      20));
}

TEST(GpsdClient, AReceiversFixesComeThroughARealGpsd) {
  const char* const program = InstalledGpsd();
  if (program == nullptr) GTEST_SKIP() << "gpsd is not installed (Debian package gpsd)";
  ExpectFixesOnceStarted([&](int port) { return std::make_shared<RealGpsd>(program, port); });
}

TEST(GpsdClient, ALogsFixesComeThroughARealGpsdFedByGpsfake) {
  if (InstalledGpsd() == nullptr || access(kGpsfake, X_OK) != 0) {
    GTEST_SKIP() << "gpsd or gpsfake is not installed (scripts/setup tests)";
  }
  const testing::TemporaryDirectory directory;
  ExpectFixesOnceStarted([&](int port) {
    return std::make_shared<FakedGpsd>(directory.path() / "receiver.nmea", port);
  });
}

}  // namespace
}  // namespace omnihdr::gpsd_test
