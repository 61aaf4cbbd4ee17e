#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/session/session.h"
#include "daemon/api/client.h"
#include "tests/faults/storage_faults.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::faults {

// What a session must be in the end, whatever happened on the way: an undisturbed run of the same
// drive. Journal lines without what differs from run to run (times of this machine).
struct Reference {
  std::map<std::string, std::string> files;  // below raw and views
  std::vector<std::string> lines;
};

// A recorded drive through a simulated tunnel, and omnihdrd that replays it into session() as fast
// as the disk takes it while it makes the views: the load under which it is disturbed.
class RecordedDrive {
 public:
  // `trigger`: "replay" (by itself) or "software" (as the test says).
  explicit RecordedDrive(int positions, const std::string& trigger = "replay");

  const std::filesystem::path& directory() const { return directory_.path(); }
  std::filesystem::path session() const { return directory() / "sessions" / "s"; }
  int positions() const { return positions_; }
  StorageFaults& faults() { return faults_; }
  // Where the next session is taken up from nothing.
  void Fresh() const { std::filesystem::remove_all(directory() / "sessions"); }

  // omnihdrd with the faults in front of its libc.
  std::unique_ptr<integration::Program> Start() const;
  ApiClient Client() const { return ApiClient(directory() / "api.sock"); }
  nlohmann::json Status() const;
  bool StatusHolds(const std::function<bool(const nlohmann::json&)>& holds) const;
  bool Ended() const { return std::filesystem::exists(session() / "ended.json"); }
  std::string Log() const;

  // An undisturbed run to its end. Call first, for it leaves no session behind.
  const Reference& Undisturbed();

  // What is wrong with the session as it lies on disk, in words; empty when nothing is. Every line
  // of the journal tells the truth about its pixels, lines that were there before (`earlier`, whole
  // lines of text) still are, every view that can be seen is whole and as the reference has it.
  std::vector<std::string> Problems(const std::string& earlier = "") const;
  // And of a session that has ended: that it is the reference, nothing missing, nothing else there.
  std::vector<std::string> Differences() const;
  // What `omnihdr verify` says where it finds damage; empty when it finds none. `strict`: what an
  // interrupted program left behind counts, too.
  std::string Damage(bool strict) const;
  // The whole lines of the journal as it lies on disk.
  std::string JournalText() const;

 private:
  testing::TemporaryDirectory directory_;
  const int positions_;
  StorageFaults faults_;
  Reference reference_;
};

// The journal's lines as Reference has them. A journal that cannot be read gives one line that says
// so.
std::vector<std::string> ComparableLines(const std::filesystem::path& session);

// A whole number from the environment, for longer runs than the usual one.
std::uint64_t FromEnvironment(const char* name, std::uint64_t otherwise);

}  // namespace omnihdr::faults
