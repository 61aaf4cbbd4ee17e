#include "daemon/api/server.h"

#include <fcntl.h>
#include <httplib.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <functional>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace omnihdr {
namespace {

constexpr std::size_t kMaxBodyBytes = 4096;
constexpr std::size_t kMaxWaitingConnections = 32;
constexpr auto kKeepAlive = std::chrono::seconds(2);

// A fixed number of threads with a bounded line in front of it: when that is full, connections wait
// in the kernel, whose line is bounded too.
class BoundedTaskQueue final : public httplib::TaskQueue {
 public:
  explicit BoundedTaskQueue(int threads) {
    for (int i = 0; i < threads; ++i) {
      threads_.emplace_back([this] { Work(); });
    }
  }
  void enqueue(std::function<void()> task) override {
    std::unique_lock lock(mutex_);
    // Not for ever: a task that is thrown away would leave its connection open for ever.
    room_.wait_for(lock, std::chrono::seconds(5),
                   [this] { return stopping_ || tasks_.size() < kMaxWaitingConnections; });
    tasks_.push_back(std::move(task));
    work_.notify_one();
  }
  void shutdown() override {
    {
      std::lock_guard lock(mutex_);
      stopping_ = true;
    }
    room_.notify_all();
    work_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }

 private:
  void Work() {
    while (true) {
      std::function<void()> task;
      {
        std::unique_lock lock(mutex_);
        work_.wait(lock, [this] { return stopping_ || !tasks_.empty(); });
        if (tasks_.empty()) return;
        task = std::move(tasks_.front());
        tasks_.pop_front();
      }
      room_.notify_one();
      task();
    }
  }

  std::mutex mutex_;
  std::condition_variable work_;
  std::condition_variable room_;
  std::deque<std::function<void()>> tasks_;
  bool stopping_ = false;
  std::vector<std::thread> threads_;
};

void Answer(httplib::Response& response, const ApiReply& reply) {
  response.status = reply.http_status;
  response.set_content(
      reply.body.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n",
      "application/json");
}

ApiReply NotNow(const Error& error) { return ApiReply::Refused(503, error.message); }

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

}  // namespace

class ApiServer::Impl {
 public:
  Impl(ApiServerOptions options, ApiBackend& backend, EventHub& hub)
      : options_(std::move(options)), backend_(backend), hub_(hub) {}
  ~Impl() { Close(); }

  Status Listen() {
    const std::string path = options_.socket.string();
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    if (path.empty() || path.size() >= sizeof(address.sun_path)) {
      return Fail(ErrorKind::kConfig, "api.socket: {}: expected a path of 1 to {} bytes", path,
                  sizeof(address.sun_path) - 1);
    }
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);

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
    return Start(path);
  }

  void Close() {
    if (server_.is_running()) server_.stop();
    if (thread_.joinable()) thread_.join();
    if (bound_) ::unlink(options_.socket.c_str());
    bound_ = false;
  }

 private:
  Status Start(const std::string& path) {
    server_.set_address_family(AF_UNIX);
    server_.set_socket_options([](socket_t) {});
    server_.set_payload_max_length(kMaxBodyBytes);
    // One request a connection: an idle client must not hold one of the few threads.
    server_.set_keep_alive_max_count(1);
    server_.set_read_timeout(std::chrono::seconds(2));
    server_.set_write_timeout(std::chrono::seconds(2));
    server_.new_task_queue = [threads = options_.threads] { return new BoundedTaskQueue(threads); };
    AddRoutes();
    // Nobody may connect before the mode is set.
    const mode_t before = ::umask(0177);
    const bool bound = server_.bind_to_port(path, 80);
    const int error_number = errno;
    ::umask(before);
    if (!bound) return FailErrno(ErrorKind::kCannotCreate, path, error_number);
    bound_ = true;
    if (::chmod(path.c_str(), static_cast<mode_t>(options_.socket_mode & 0777U)) != 0) {
      return FailErrno(ErrorKind::kCannotCreate, fmt::format("{}: set its mode", path), errno);
    }
    thread_ = std::thread([this] { server_.listen_after_bind(); });
    for (int i = 0; i < 500 && !server_.is_running(); ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    if (!server_.is_running()) {
      return Fail(ErrorKind::kSystem, "{}: the server did not start within 5 s", path);
    }
    return {};
  }

  void AddRoutes() {
    using httplib::Request;
    using httplib::Response;
    server_.Get("/v1/status", [this](const Request&, Response& response) {
      const Result<StatusReport> status = backend_.GetStatus();
      Answer(response, status ? ApiReply{200, StatusToJson(*status)} : NotNow(status.error()));
    });
    server_.Get("/metrics", [this](const Request&, Response& response) {
      const Result<StatusReport> status = backend_.GetStatus();
      if (!status) return Answer(response, NotNow(status.error()));
      response.set_content(StatusToMetrics(*status), "text/plain; version=0.0.4; charset=utf-8");
    });
    server_.Get("/v1/events", [this](const Request& request, Response& response) {
      StreamEvents(request, response);
    });
    const auto post = [this](const char* route, ApiReply (ApiBackend::*method)()) {
      server_.Post(route, [this, method](const Request&, Response& response) {
        Answer(response, (backend_.*method)());
      });
      RefuseGet(route);
    };
    post("/v1/arm", &ApiBackend::Arm);
    post("/v1/disarm", &ApiBackend::Disarm);
    post("/v1/trigger", &ApiBackend::Trigger);
    post("/v1/finish", &ApiBackend::Finish);
    post("/v1/reload", &ApiBackend::Reload);
    server_.Post("/v1/stop", [this](const Request& request, Response& response) {
      bool leave_open = false;
      if (!request.body.empty()) {
        const auto body = nlohmann::json::parse(request.body, nullptr, false);
        if (!body.is_object() ||
            (body.contains("leave_open") && !body["leave_open"].is_boolean())) {
          return Answer(response,
                        ApiReply::Refused(400, "body: expected {\"leave_open\": true or false}"));
        }
        leave_open = body.value("leave_open", false);
      }
      Answer(response, backend_.Stop(leave_open));
    });
    RefuseGet("/v1/stop");

    server_.set_error_handler([](const Request& request, Response& response) {
      if (!response.body.empty()) return;
      std::string message =
          fmt::format("{} {}: HTTP {}", request.method, request.path, response.status);
      if (response.status == 404) message = fmt::format("{}: no such route", request.path);
      if (response.status == 413) {
        message = fmt::format("the body is too large: expected at most {} bytes", kMaxBodyBytes);
      }
      Answer(response, ApiReply::Refused(response.status, message));
    });
    server_.set_exception_handler(
        [](const Request&, Response& response, std::exception_ptr thrown) {
          std::string message = "unknown error";
          try {
            std::rethrow_exception(thrown);
          } catch (const std::exception& e) {
            message = e.what();
          } catch (...) {
          }
          Answer(response, ApiReply::Refused(500, message));
        });
  }

  void RefuseGet(const char* route) {
    server_.Get(route, [route](const httplib::Request&, httplib::Response& response) {
      Answer(response, ApiReply::Refused(405, fmt::format("{}: expected POST", route)));
    });
  }

  void StreamEvents(const httplib::Request& request, httplib::Response& response) {
    const std::shared_ptr<EventHub::Subscription> events = hub_.Subscribe();
    if (!events) {
      return Answer(response, ApiReply::Refused(503, "too many listeners on the event stream"));
    }
    const Result<StatusReport> status = backend_.GetStatus();
    if (!status) return Answer(response, NotNow(status.error()));
    const bool server_sent =
        request.get_header_value("Accept").find("text/event-stream") != std::string::npos;
    const auto frame = [server_sent](const std::string& line) {
      return server_sent ? "data: " + line + "\n\n" : line + "\n";
    };
    nlohmann::json first = StatusToJson(*status);
    first["event"] = "status";
    response.set_chunked_content_provider(
        server_sent ? "text/event-stream" : "application/x-ndjson",
        [events, frame,
         head = frame(first.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace))](
            std::size_t, httplib::DataSink& sink) mutable {
          if (!head.empty()) {
            const bool written = sink.write(head.data(), head.size());
            head.clear();
            return written;
          }
          std::optional<std::string> event = events->Next(kKeepAlive);
          if (!event && events->closed()) {
            sink.done();
            return true;
          }
          // A sign of life now and then: a client that has gone is noticed by the failing write.
          const std::string text = frame(event ? *event : R"({"event":"alive"})");
          return sink.write(text.data(), text.size());
        });
  }

  const ApiServerOptions options_;
  ApiBackend& backend_;
  EventHub& hub_;
  httplib::Server server_;
  std::thread thread_;
  Fd lock_;
  bool bound_ = false;
};

Result<std::unique_ptr<ApiServer>> ApiServer::Listen(const ApiServerOptions& options,
                                                     ApiBackend& backend, EventHub& hub) {
  auto impl = std::make_unique<Impl>(options, backend, hub);
  OMNIHDR_TRY(impl->Listen());
  return std::unique_ptr<ApiServer>(new ApiServer(std::move(impl)));
}

ApiServer::ApiServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ApiServer::~ApiServer() = default;

}  // namespace omnihdr
