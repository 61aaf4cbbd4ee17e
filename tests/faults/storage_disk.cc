#include "tests/faults/storage_disk.h"

#include <cstring>
#include <fstream>
#include <stdexcept>
#include <utility>

#include "core/base/file.h"

namespace omnihdr::faults {

namespace fs = std::filesystem;

std::vector<RecordedStep> ReadRecord(const fs::path& file) {
  const std::string bytes = ReadTextFile(file, std::size_t{1} << 32).value_or("");
  std::vector<RecordedStep> steps;
  std::size_t at = 0;
  const auto take = [&](std::size_t count) {
    if (bytes.size() - at < count) throw std::runtime_error(file.string() + ": ends early");
    std::string part = bytes.substr(at, count);
    at += count;
    return part;
  };
  while (at < bytes.size()) {
    RecordedStep step;
    const std::string header = take(sizeof step.header);
    std::memcpy(&step.header, header.data(), header.size());
    step.path = take(step.header.path_bytes);
    step.other_path = take(step.header.other_path_bytes);
    if (step.header.call == Call::kWrite) step.data = take(step.header.data_bytes);
    steps.push_back(std::move(step));
  }
  return steps;
}

StorageDisk::StorageDisk() : root_(std::make_shared<Node>()) { root_->is_directory = true; }

StorageDisk::Node* StorageDisk::At(const std::string& path) const {
  if (path == ".") return root_.get();
  const Place place = Find(path);
  if (place.directory == nullptr) return nullptr;
  const auto found = place.directory->names.find(place.name);
  return found == place.directory->names.end() ? nullptr : found->second.get();
}

StorageDisk::Place StorageDisk::Find(const std::string& path) const {
  const fs::path whole(path);
  Node* directory = root_.get();
  for (const fs::path& part : whole.parent_path()) {
    const auto found = directory->names.find(part.string());
    if (found == directory->names.end()) return {};
    directory = found->second.get();
  }
  return {directory, whole.filename().string()};
}

void StorageDisk::Apply(const RecordedStep& step) {
  const RecordedCall& call = step.header;
  if (call.call == Call::kMakeDirectory || call.call == Call::kOpen) {
    if (step.path == ".") return;
    const Place place = Find(step.path);
    if (place.directory == nullptr) return;
    std::shared_ptr<Node>& node = place.directory->names[place.name];
    if (!node) {
      node = std::make_shared<Node>();
      node->is_directory = call.call == Call::kMakeDirectory;
    }
    if (call.call == Call::kOpen && call.offset == 1) node->content.clear();
    return;
  }
  if (call.call == Call::kRename) {
    const Place from = Find(step.path);
    const Place to = Find(step.other_path);
    if (from.directory == nullptr || to.directory == nullptr) return;
    if (call.exchange != 0) {
      std::swap(from.directory->names[from.name], to.directory->names[to.name]);
      return;
    }
    std::shared_ptr<Node> node = std::move(from.directory->names[from.name]);
    from.directory->names.erase(from.name);
    to.directory->names[to.name] = std::move(node);
    return;
  }
  if (call.call == Call::kRemove) {
    const Place place = Find(step.path);
    if (place.directory != nullptr) place.directory->names.erase(place.name);
    return;
  }
  Node* node = At(step.path);
  if (node == nullptr) return;
  switch (call.call) {
    case Call::kWrite:
      if (node->content.size() < call.offset + step.data.size()) {
        node->content.resize(call.offset + step.data.size());
      }
      node->content.replace(call.offset, step.data.size(), step.data);
      break;
    case Call::kTruncate:
      node->content.resize(call.data_bytes);
      break;
    case Call::kSync:
      node->sure_content = node->content;
      break;
    case Call::kSyncDirectory:
      node->sure_names = node->names;
      break;
    default:
      break;
  }
}

void StorageDisk::Write(const Node& node, Survives survives, const fs::path& directory) {
  fs::create_directories(directory);
  for (const auto& [name, below] : survives == Survives::kNames ? node.names : node.sure_names) {
    if (below->is_directory) {
      Write(*below, survives, directory / name);
    } else {
      std::ofstream(directory / name, std::ios::binary)
          << (survives == Survives::kContent ? below->content : below->sure_content);
    }
  }
}

void StorageDisk::Write(Survives survives, const fs::path& directory) const {
  Write(*root_, survives, directory);
}

}  // namespace omnihdr::faults
