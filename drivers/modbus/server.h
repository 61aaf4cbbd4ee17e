#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/base/stage.h"
#include "core/capture/appliance.h"
#include "drivers/modbus/connection.h"
#include "drivers/modbus/responder.h"

namespace omnihdr::modbus {

struct ServerOptions {
  Endpoint endpoint;                            // TCP: where to listen; RTU: the serial device
  std::size_t clients = 8;                      // at a time; more are turned away
  Nanoseconds idle = std::chrono::seconds(60);  // a silent client is let go after this
  Nanoseconds longest_pause = std::chrono::seconds(10);  // between attempts to open
  Status Validate() const { return endpoint.Validate(); }
};

// Shows the appliance's status to Modbus masters and takes their commands, with a thread of its
// own. What any number of clients send cannot block it, crash it, or make it hold more memory: a
// client that sends what is no Modbus, does not read its answers or is silent is let go; one that
// sends without pause is slowed down to 1600 requests a second.
class StatusServer final : public StatusOutput, public VehicleLink {
 public:
  // `command` empty: the server only shows. `clock` must outlive the server.
  StatusServer(const ServerOptions& options, CommandHandler command, const Clock& clock);
  ~StatusServer() override;

  std::string_view name() const override { return "modbus server"; }
  Status Start() override;
  LinkReport report() const override;
  void Show(const ApplianceStatus& status) override;
  // The port it listens on; 0 until it does.
  int port() const { return port_.load(); }

 private:
  struct Connected {
    Fd fd;
    TcpFramer framer;
    HostTime last_heard;
    HostTime rests_until;
    bool gone = false;
  };

  Status Run(std::stop_token stop, Stage& self);
  Status Open();
  Status ServeTcp();
  Status ServeSerial();
  void Accept();
  void Hear(Connected& client);
  Status HearSerial();
  std::size_t Answer(std::span<const std::uint8_t> request,
                     std::span<std::uint8_t, kMaxPdu> answer);
  void CountError();

  const ServerOptions options_;
  const Clock& clock_;
  Fd wake_;
  // The thread's own.
  Responder responder_;
  Fd listener_;
  Fd serial_;
  RtuFramer rtu_;
  HostTime heard_serial_;
  std::vector<std::unique_ptr<Connected>> connected_;

  std::atomic<int> port_ = 0;
  mutable std::mutex mutex_;  // of what follows, up to the blank line
  ApplianceStatus status_;
  bool shown_ = false;
  LinkReport report_;

  std::unique_ptr<Stage> stage_;  // last: uses everything
};

}  // namespace omnihdr::modbus
