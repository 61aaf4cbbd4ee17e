#include "daemon/logging.h"

#include <fmt/format.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <sys/syslog.h>
#include <sys/uio.h>
#include <systemd/sd-journal.h>
#include <unistd.h>

#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

namespace omnihdr {
namespace {

bool StderrIsTheJournal() {
  const char* stream = std::getenv("JOURNAL_STREAM");
  struct stat info {};
  if (stream == nullptr || ::fstat(STDERR_FILENO, &info) != 0) return false;
  return std::string(stream) == std::to_string(info.st_dev) + ":" + std::to_string(info.st_ino);
}

int Priority(spdlog::level::level_enum level) {
  switch (level) {
    case spdlog::level::trace:
    case spdlog::level::debug:
      return LOG_DEBUG;
    case spdlog::level::warn:
      return LOG_WARNING;
    case spdlog::level::err:
      return LOG_ERR;
    case spdlog::level::critical:
      return LOG_CRIT;
    default:
      return LOG_INFO;
  }
}

// By the journal's own protocol: a line of text alone could carry no fields.
class JournalSink final : public spdlog::sinks::base_sink<std::mutex> {
 protected:
  void sink_it_(const spdlog::details::log_msg& message) override {
    const std::string_view text(message.payload.data(), message.payload.size());
    const int priority = Priority(message.level);
    std::vector<std::string> entry = JournalEntry(priority, text, LogContext::Current());
    std::vector<iovec> parts;
    parts.reserve(entry.size());
    for (std::string& field : entry) parts.push_back({field.data(), field.size()});
    if (sd_journal_sendv(parts.data(), static_cast<int>(parts.size())) >= 0) return;
    // What cannot be sent is not lost: the journal reads standard error too.
    const std::string line = fmt::format("<{}>{}\n", priority, text);
    [[maybe_unused]] const ssize_t written = ::write(STDERR_FILENO, line.data(), line.size());
  }
  void flush_() override {}
};

thread_local LogFields log_fields;
std::mutex log_session_mutex;
std::string& LogSession() {
  static std::string session;
  return session;
}

spdlog::level::level_enum Severity(LogLevel level) {
  switch (level) {
    case LogLevel::kDebug:
      return spdlog::level::debug;
    case LogLevel::kInfo:
      return spdlog::level::info;
    case LogLevel::kWarning:
      return spdlog::level::warn;
    case LogLevel::kError:
      break;
  }
  return spdlog::level::err;
}

}  // namespace

void InitLogging(LogLevel level) {
  spdlog::sink_ptr sink;
  if (StderrIsTheJournal()) {
    sink = std::make_shared<JournalSink>();
  } else {
    sink = std::make_shared<spdlog::sinks::stderr_sink_mt>();
    sink->set_pattern("%Y-%m-%d %H:%M:%S.%e %l %v");
  }
  auto logger = std::make_shared<spdlog::logger>("", std::move(sink));
  logger->set_level(Severity(level));
  logger->flush_on(spdlog::level::debug);
  spdlog::set_default_logger(std::move(logger));
}

void SetLogLevel(LogLevel level) { spdlog::set_level(Severity(level)); }

LogContext::LogContext(LogFields fields) : before_(log_fields) {
  LogFields& current = log_fields;
  if (!fields.session.empty()) current.session = std::move(fields.session);
  if (fields.trigger) current.trigger = fields.trigger;
  if (fields.position) current.position = fields.position;
  if (!fields.stage.empty()) current.stage = std::move(fields.stage);
  if (!fields.error.empty()) current.error = std::move(fields.error);
}

LogContext::~LogContext() { log_fields = std::move(before_); }

LogFields LogContext::Current() {
  LogFields fields = log_fields;
  if (fields.session.empty()) {
    std::lock_guard lock(log_session_mutex);
    fields.session = LogSession();
  }
  return fields;
}

void SetLogSession(const std::string& directory) {
  std::lock_guard lock(log_session_mutex);
  LogSession() = directory;
}

std::vector<std::string> JournalEntry(int priority, std::string_view message,
                                      const LogFields& fields) {
  std::vector<std::string> entry = {fmt::format("MESSAGE={}", message),
                                    fmt::format("PRIORITY={}", priority),
                                    "SYSLOG_IDENTIFIER=omnihdrd"};
  const auto add = [&entry](std::string_view name, const std::string& value) {
    if (!value.empty()) entry.push_back(fmt::format("OMNIHDR_{}={}", name, value));
  };
  add("SESSION", fields.session);
  if (fields.trigger) add("TRIGGER", fmt::format("{}", *fields.trigger));
  if (fields.position) add("POSITION", fmt::format("{}", *fields.position));
  add("STAGE", fields.stage);
  add("ERROR", fields.error);
  return entry;
}

std::optional<std::uint64_t> FloodGate::Pass(HostTime now) {
  ++held_;
  if (last_ && now - *last_ < interval_) return std::nullopt;
  last_ = now;
  return std::exchange(held_, 0);
}

}  // namespace omnihdr
