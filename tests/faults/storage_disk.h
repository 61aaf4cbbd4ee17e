#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "tests/faults/storage_faults.h"

namespace omnihdr::faults {

// What a disk holds after a power cut, by the record of calls (StorageFaults::RecordTo): a file's
// content is sure once the file was synchronised, a name once its directory was. What was not may
// be there or not.
enum class Survives {
  kOnlyWhatIsSure,  // content and names of the last synchronisation
  kNames,           // every name, but content only as synchronised: renamed before it was written
  kContent,         // all content, but names only as synchronised
};

struct RecordedStep {
  RecordedCall header;
  std::string path;  // below the session; "." = the session's directory
  std::string other_path;
  std::string data;
};
std::vector<RecordedStep> ReadRecord(const std::filesystem::path& file);

// The session's directory as calls change it, in memory.
class StorageDisk {
 public:
  StorageDisk();
  void Apply(const RecordedStep& step);
  // Writes what survives into an empty directory.
  void Write(Survives survives, const std::filesystem::path& directory) const;

 private:
  struct Node {
    bool is_directory = false;
    std::string content;
    std::string sure_content;
    std::map<std::string, std::shared_ptr<Node>> names;
    std::map<std::string, std::shared_ptr<Node>> sure_names;
  };
  struct Place {
    Node* directory = nullptr;  // null: no such directory
    std::string name;
  };
  Place Find(const std::string& path) const;
  Node* At(const std::string& path) const;
  static void Write(const Node& node, Survives survives, const std::filesystem::path& directory);

  std::shared_ptr<Node> root_;
};

}  // namespace omnihdr::faults
