#include "daemon/api/server.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <grp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <functional>
#include <mutex>
#include <set>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/base/tcp.h"
#include "daemon/api/connection.h"
#include "daemon/api/token.h"

namespace omnihdr {
namespace {

// A sign of life on an event stream: a client that has gone is noticed by the failing write.
constexpr auto kStreamAlive = std::chrono::seconds(2);
// How long a client may take to read its answer's end.
constexpr auto kGoodbye = std::chrono::milliseconds(500);

HostTime Now() { return SystemClock().Now(); }

// So many at once, and so many a second in the long run. Any thread.
class RateLimit {
 public:
  RateLimit(double per_second, double burst)
      : per_second_(per_second), burst_(burst), left_(burst), since_(Now()) {}
  bool Allows() {
    std::lock_guard lock(mutex_);
    const HostTime now = Now();
    left_ += static_cast<double>((now - since_).count()) * 1e-9 * per_second_;
    left_ = std::min(left_, burst_);
    since_ = now;
    if (left_ < 1.0) return false;
    left_ -= 1.0;
    return true;
  }

 private:
  const double per_second_;
  const double burst_;
  std::mutex mutex_;
  double left_;
  HostTime since_;
};

// One way in: accepts connections on a listening socket and hands them to a fixed number of
// threads, with a bounded line in front of them.
class Door {
 public:
  using Serve = std::function<void(HttpConnection&)>;
  Door(Fd listener, int threads, Serve serve)
      : listener_(std::move(listener)),
        wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
        serve_(std::move(serve)) {
    for (int i = 0; i < threads; ++i) threads_.emplace_back([this] { Work(); });
    threads_.emplace_back([this] { Accept(); });
  }
  ~Door() {
    {
      std::lock_guard lock(mutex_);
      closing_ = true;
      // Whoever waits for a request is woken; an answer that is under way is sent.
      for (const int fd : served_) ::shutdown(fd, SHUT_RD);
      waiting_.clear();
    }
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = ::write(wake_.get(), &one, sizeof one);
    changed_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }
  Door(const Door&) = delete;
  Door& operator=(const Door&) = delete;
  int fd() const { return listener_.get(); }

 private:
  void Accept() {
    while (true) {
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, [this] { return closing_ || waiting_.size() < ApiServer::kWaiting; });
        if (closing_) return;
      }
      pollfd watched[2] = {{listener_.get(), POLLIN, 0}, {wake_.get(), POLLIN, 0}};
      if (::poll(watched, 2, -1) < 0 && errno != EINTR) return;
      Fd client(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
      if (!client.valid()) {
        // Too many descriptors: they come back when a request ends.
        if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
          std::this_thread::sleep_for(std::chrono::milliseconds(50));
        }
        continue;
      }
      std::lock_guard lock(mutex_);
      if (closing_) return;
      waiting_.push_back(std::move(client));
      changed_.notify_all();
    }
  }

  void Work() {
    while (true) {
      Fd client;
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, [this] { return closing_ || !waiting_.empty(); });
        if (closing_) return;
        client = std::move(waiting_.front());
        waiting_.pop_front();
        served_.insert(client.get());
      }
      changed_.notify_all();
      HttpConnection connection(std::move(client));
      serve_(connection);
      // Before it is closed: its number may be another connection's right after.
      std::lock_guard lock(mutex_);
      served_.erase(connection.fd());
      HttpConnection closed = std::move(connection);
    }
  }

  const Fd listener_;
  const Fd wake_;
  const Serve serve_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool closing_ = false;
  std::deque<Fd> waiting_;
  std::set<int> served_;
  std::vector<std::thread> threads_;
};

// Whether a process listens on the socket file.
Result<bool> SomebodyListens(const sockaddr_un& address) {
  const Fd probe(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!probe.valid()) return FailErrno(ErrorKind::kSystem, "socket", errno);
  if (::connect(probe.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0 ||
      errno == EAGAIN) {
    return true;
  }
  return false;
}

Result<gid_t> GroupNumber(const std::string& name) {
  std::vector<char> room(std::size_t{1} << 16);
  group found{};
  group* result = nullptr;
  if (const int error = ::getgrnam_r(name.c_str(), &found, room.data(), room.size(), &result);
      error != 0) {
    return FailErrno(ErrorKind::kSystem, fmt::format("api.socket_group: {}", name), error);
  }
  if (result == nullptr) {
    return Fail(ErrorKind::kConfig, "api.socket_group: \"{}\", expected a group of this machine",
                name);
  }
  return found.gr_gid;
}

std::string Head(const HttpAnswer& answer, std::string_view framing) {
  return fmt::format(
      "HTTP/1.1 {} {}\r\nContent-Type: {}\r\n{}Connection: close\r\nCache-Control: no-store\r\n"
      "X-Content-Type-Options: nosniff\r\n{}\r\n",
      answer.status, HttpReason(answer.status), answer.type,
      answer.status == 401   ? "WWW-Authenticate: Bearer\r\n"
      : answer.status == 429 ? "Retry-After: 1\r\n"
                             : "",
      framing);
}

}  // namespace

class ApiServer::Impl {
 public:
  Impl(ApiServerOptions options, ApiBackend& backend, EventHub& hub)
      : options_(std::move(options)),
        backend_(backend),
        hub_(hub),
        tcp_rate_(options_.tcp.requests_per_s, options_.tcp.burst) {}
  ~Impl() {
    tcp_.reset();
    unix_.reset();
    if (bound_) ::unlink(options_.socket.c_str());
  }

  Status Listen() {
    OMNIHDR_ASSIGN(Fd unix_listener, ListenUnix());
    bound_ = true;
    if (!options_.tcp.address.empty()) {
      if (options_.tcp.token.size() < kMinTokenBytes) {
        return Fail(ErrorKind::kConfig, "api.tcp: expected a token of at least {} characters",
                    kMinTokenBytes);
      }
      OMNIHDR_ASSIGN(Fd listener, ListenTcp(options_.tcp.address, options_.tcp.port));
      tcp_port_ = LocalPort(listener.get());
      tcp_ =
          std::make_unique<Door>(std::move(listener), kTcpThreads,
                                 [this](HttpConnection& connection) { Serve(connection, true); });
    }
    unix_ =
        std::make_unique<Door>(std::move(unix_listener), kUnixThreads,
                               [this](HttpConnection& connection) { Serve(connection, false); });
    return {};
  }

  ApiServerCounts counts() const {
    return {requests_, malformed_, late_, unauthorized_, too_many_};
  }
  int tcp_port() const { return tcp_port_; }

 private:
  Result<Fd> ListenUnix() {
    const std::string path = options_.socket.string();
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    if (path.empty() || path.size() >= sizeof(address.sun_path)) {
      return Fail(ErrorKind::kConfig, "api.socket: {}: expected a path of 1 to {} bytes", path,
                  sizeof(address.sun_path) - 1);
    }
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
    std::optional<gid_t> owner;
    if (!options_.socket_group.empty()) {
      OMNIHDR_ASSIGN(owner, GroupNumber(options_.socket_group));
    }

    std::error_code error;
    if (const auto parent = options_.socket.parent_path(); !parent.empty()) {
      std::filesystem::create_directories(parent, error);
      if (error) {
        return FailErrno(ErrorKind::kCannotCreate, parent.string(), error.value());
      }
    }
    // Of two daemons that start at the same moment only the holder of the lock may replace the
    // file.
    const std::string lock_path = path + ".lock";
    lock_ = Fd(::open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    if (!lock_.valid()) return FailErrno(ErrorKind::kCannotCreate, lock_path, errno);
    if (::flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) {
      return Fail(ErrorKind::kTemporary, "{}: another omnihdrd is serving here", path);
    }
    struct stat info {};
    if (::lstat(path.c_str(), &info) == 0) {
      if (!S_ISSOCK(info.st_mode)) {
        return Fail(ErrorKind::kCannotCreate, "{}: exists and is not a socket", path);
      }
      OMNIHDR_ASSIGN(const bool listened, SomebodyListens(address));
      if (listened) {
        return Fail(ErrorKind::kTemporary, "{}: another program is listening here", path);
      }
      ::unlink(path.c_str());
    }

    Fd listener(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    if (!listener.valid()) return FailErrno(ErrorKind::kSystem, "socket", errno);
    // Nobody may connect before group and mode are set.
    const mode_t before = ::umask(0177);
    const bool bound =
        ::bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0;
    const int error_number = errno;
    ::umask(before);
    if (!bound) return FailErrno(ErrorKind::kCannotCreate, path, error_number);
    if (owner && ::chown(path.c_str(), static_cast<uid_t>(-1), *owner) != 0) {
      return FailErrno(ErrorKind::kPermission,
                       fmt::format("{}: give it to group {}", path, options_.socket_group), errno);
    }
    if (::chmod(path.c_str(), static_cast<mode_t>(options_.socket_mode & 0777U)) != 0) {
      return FailErrno(ErrorKind::kCannotCreate, fmt::format("{}: set its mode", path), errno);
    }
    if (::listen(listener.get(), kBacklog) != 0) {
      return FailErrno(ErrorKind::kSystem, fmt::format("{}: listen", path), errno);
    }
    return listener;
  }

  void Serve(HttpConnection& connection, bool tcp) {
    HttpReader reader;
    const HostTime deadline = Now() + options_.request_deadline;
    const bool whole = connection.Read(reader, deadline);
    // A client that has gone is told nothing.
    if (!whole && Now() < deadline) return;
    HttpAnswer answer;
    if (!whole) {
      ++late_;
      answer = ToAnswer(ApiReply::Refused(408, "the request was not whole in time"));
    } else if (reader.state() == HttpReader::State::kRefused) {
      ++malformed_;
      answer = ToAnswer(ApiReply::Refused(reader.status(), reader.reason()));
    } else if (tcp && !tcp_rate_.Allows()) {
      ++too_many_;
      answer = ToAnswer(ApiReply::Refused(429, "too many requests: try again in a second"));
    } else if (tcp && !HasToken(reader.request())) {
      ++unauthorized_;
      answer =
          ToAnswer(ApiReply::Refused(401,
                                     "expected the header \"Authorization: Bearer TOKEN\" with "
                                     "the daemon's token (api.token_file)"));
    } else {
      ++requests_;
      if (reader.request().method == "GET" && reader.request().target == kEventsRoute) {
        StreamEvents(reader.request(), connection);
        return;
      }
      answer = AnswerRequest(reader.request(), backend_);
    }
    Send(connection, answer);
  }

  bool HasToken(const HttpRequest& request) const {
    constexpr std::string_view kScheme = "Bearer ";
    std::string_view presented = request.authorization;
    if (!presented.starts_with(kScheme)) return false;
    presented.remove_prefix(kScheme.size());
    return SameToken(presented, options_.tcp.token);
  }

  void Send(HttpConnection& connection, const HttpAnswer& answer) const {
    const std::string head =
        Head(answer, fmt::format("Content-Length: {}\r\n", answer.body.size()));
    if (!connection.Write(head + answer.body, Now() + options_.answer_deadline)) return;
    connection.Finish(Now() + Nanoseconds(kGoodbye));
  }

  void StreamEvents(const HttpRequest& request, HttpConnection& connection) {
    const std::shared_ptr<EventHub::Subscription> events = hub_.Subscribe();
    if (!events) {
      return Send(connection,
                  ToAnswer(ApiReply::Refused(503, "too many listeners on the event stream")));
    }
    const Result<StatusReport> status = backend_.GetStatus();
    if (!status) {
      return Send(connection, ToAnswer(ApiReply::Refused(503, status.error().message)));
    }
    const bool server_sent = request.accept.find("text/event-stream") != std::string::npos;
    const auto write = [&](const std::string& text) {
      return connection.Write(
          request.chunks ? fmt::format("{:x}\r\n{}\r\n", text.size(), text) : text,
          Now() + options_.answer_deadline);
    };
    const auto frame = [server_sent](const std::string& line) {
      return server_sent ? "data: " + line + "\n\n" : line + "\n";
    };
    HttpAnswer answer;
    answer.type = server_sent ? "text/event-stream" : "application/x-ndjson";
    nlohmann::json first = StatusToJson(*status);
    first["event"] = "status";
    if (!connection.Write(Head(answer, request.chunks ? "Transfer-Encoding: chunked\r\n" : ""),
                          Now() + options_.answer_deadline) ||
        !write(frame(first.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace)))) {
      return;
    }
    while (true) {
      std::optional<std::string> event = events->Next(kStreamAlive);
      if (!event && events->closed()) {
        // What was published between the end of the wait and the end of the stream.
        event = events->Next(Nanoseconds(0));
        if (!event) break;
      }
      if (!write(frame(event ? *event : R"({"event":"alive"})"))) return;
    }
    if (request.chunks && !connection.Write("0\r\n\r\n", Now() + options_.answer_deadline)) {
      return;
    }
    connection.Finish(Now() + Nanoseconds(kGoodbye));
  }

  const ApiServerOptions options_;
  ApiBackend& backend_;
  EventHub& hub_;
  RateLimit tcp_rate_;
  Fd lock_;
  bool bound_ = false;
  int tcp_port_ = 0;
  std::atomic<std::uint64_t> requests_ = 0;
  std::atomic<std::uint64_t> malformed_ = 0;
  std::atomic<std::uint64_t> late_ = 0;
  std::atomic<std::uint64_t> unauthorized_ = 0;
  std::atomic<std::uint64_t> too_many_ = 0;
  std::unique_ptr<Door> unix_;
  std::unique_ptr<Door> tcp_;
};

Result<std::unique_ptr<ApiServer>> ApiServer::Listen(const ApiServerOptions& options,
                                                     ApiBackend& backend, EventHub& hub) {
  auto impl = std::make_unique<Impl>(options, backend, hub);
  OMNIHDR_TRY(impl->Listen());
  return std::unique_ptr<ApiServer>(new ApiServer(std::move(impl)));
}

ApiServer::ApiServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ApiServer::~ApiServer() = default;
ApiServerCounts ApiServer::counts() const { return impl_->counts(); }
int ApiServer::tcp_port() const { return impl_->tcp_port(); }

}  // namespace omnihdr
