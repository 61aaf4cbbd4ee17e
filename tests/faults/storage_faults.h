#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace omnihdr::faults {

// Faults of the storage below a session directory, for a program that runs with the library
// storage_faults in front of libc (LD_PRELOAD, or linked first). The library counts every call that
// changes something there and, as a block of shared memory tells it, kills the program at one of
// them, lets calls fail, makes them slow, or keeps a record of them. The program itself is the
// shipped one: it has no code for this.

// What a call does.
enum class Call : std::uint32_t {
  kOpen,           // to write
  kWrite,          // and its variants
  kSync,           // fsync or fdatasync of a file
  kSyncDirectory,  // fsync of a directory
  kRename,
  kMakeDirectory,
  kRemove,    // unlink, rmdir
  kTruncate,  // ftruncate
  kAllocate,  // fallocate
};
inline constexpr std::size_t kCalls = 9;
std::string_view ToString(Call call);

// What it does it to. Temporary files count as what they become.
enum class File : std::uint32_t {
  kInfo,      // session.json and what lies beside it from the start
  kJournal,   // frames.jsonl
  kPixels,    // raw/000000.png
  kEnded,     // ended.json
  kSession,   // the session's directory
  kRaw,       // raw
  kViews,     // views
  kView,      // views/000003, also under its temporary name
  kRadiance,  // and the other files of a view
  kDisparity,
  kPreview,
  kRecord,  // view.json
  kKeyframe,
  kOther,  // timings.jsonl, ...
};
inline constexpr std::size_t kFiles = 14;
std::string_view ToString(File file);
// Of a path relative to the session's directory.
File FileOf(std::string_view relative_path);

// Where a program is killed: before the call, after half of a write, or after the call.
enum class Moment : std::uint32_t { kBefore, kHalf, kAfter };
std::string_view ToString(Moment moment);

// The shared block. Every member may change while the program runs.
struct Control {
  std::atomic<std::uint32_t> ready;  // 1 when the rest is filled in
  std::array<char, 1024> session;    // absolute path of the session's directory
  std::array<char, 1024> record;     // where calls are recorded; empty = nowhere
  std::atomic<std::uint64_t> calls;  // so far
  std::array<std::array<std::atomic<std::uint64_t>, kFiles>, kCalls> counts;

  // Killed at the call of this number, counted from 1; 0 = never. Of all calls, or of those of
  // one kind and file where kill_point is call * kFiles + file + 1.
  std::atomic<std::uint64_t> kill_at;
  std::atomic<std::uint32_t> kill_point;
  std::atomic<std::uint32_t> kill_moment;

  // errno of the calls, by kind; 0 = they succeed. Only of the files in the mask.
  std::array<std::atomic<std::int32_t>, kCalls> error;
  std::atomic<std::uint32_t> error_files;
  // The call of this number fails once with fail_error; 0 = none.
  std::atomic<std::uint64_t> fail_at;
  std::atomic<std::int32_t> fail_error;
  std::atomic<std::uint64_t> failed;
  // Bytes that may still be written before writes are short and then fail with ENOSPC.
  std::atomic<std::int64_t> room;
  // Microseconds a synchronisation takes longer, and a megabyte of writing.
  std::atomic<std::uint32_t> slow_sync_us;
  std::atomic<std::uint32_t> slow_megabyte_us;
};
inline constexpr std::int64_t kEndlessRoom = std::int64_t{1} << 62;
inline constexpr std::uint32_t kAllFiles = (1U << kFiles) - 1;

// One call as it is recorded: this header, then the paths and the data.
struct RecordedCall {
  Call call{};
  std::uint32_t path_bytes = 0;
  std::uint32_t other_path_bytes = 0;  // of a rename: the new name
  std::uint32_t exchange = 0;          // of a rename: both names change their places
  std::uint64_t offset = 0;            // of a write; of an opening: 1 = it empties the file
  std::uint64_t data_bytes = 0;        // of a write; of a truncation: the new length
};

// The block's owner: makes it as a file, tells the environment a program needs.
class StorageFaults {
 public:
  // `session` need not exist yet.
  StorageFaults(const std::filesystem::path& block, const std::filesystem::path& session);
  ~StorageFaults();
  StorageFaults(const StorageFaults&) = delete;
  StorageFaults& operator=(const StorageFaults&) = delete;

  // For a program of its own.
  std::vector<std::string> Environment() const;
  // For this program, in which the library is linked: from now on.
  void ActivateHere() const;

  // No faults, counts at zero.
  void Clear();
  void KillAt(std::uint64_t number, Moment moment);
  void KillAt(Call call, File file, std::uint64_t number, Moment moment);
  // All calls of the kinds given fail with `error`; 0 = no more. `files` is a mask of 1 << File.
  void Fail(std::initializer_list<Call> calls, int error, std::uint32_t files = kAllFiles);
  void FailOnce(std::uint64_t number, int error);
  void LeaveRoom(std::int64_t bytes);
  void Slow(std::uint32_t sync_us, std::uint32_t megabyte_us);
  void RecordTo(const std::filesystem::path& file);

  std::uint64_t calls() const;
  std::uint64_t failed() const;
  struct Point {
    Call call{};
    File file{};
    std::uint64_t count = 0;
    std::string Name() const;
  };
  // What was called at least once.
  std::vector<Point> points() const;

 private:
  std::filesystem::path block_;
  std::filesystem::path session_;
  Control* control_ = nullptr;
};

}  // namespace omnihdr::faults

// Switches the library on in a program that it is linked with. Not thread-safe.
extern "C" void OmnihdrStorageFaults(const char* block);
