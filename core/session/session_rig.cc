#include "core/session/session_rig.h"

#include <algorithm>
#include <string>
#include <utility>

#include "core/base/file.h"
#include "core/session/rig_file.h"

namespace omnihdr {

Result<std::vector<SessionFile>> ReadRigFiles(const std::filesystem::path& directory) {
  return ReadRigFilesOf(directory / "rig.toml");
}

Result<std::vector<SessionFile>> ReadRigFilesOf(const std::filesystem::path& rig_file) {
  const std::filesystem::path directory = rig_file.parent_path();
  OMNIHDR_ASSIGN(std::string text, ReadTextFile(rig_file, kMaxRigBytes));
  OMNIHDR_ASSIGN(const Rig rig, ParseRig(text, rig_file.string()));
  std::vector<SessionFile> files;
  files.push_back({"rig.toml", std::move(text)});
  for (const RigSensor& sensor : rig.sensors) {
    const std::string& name = sensor.mask_file;
    const bool known = std::any_of(files.begin(), files.end(),
                                   [&name](const SessionFile& file) { return file.name == name; });
    if (name.empty() || known) continue;
    const std::filesystem::path relative(name);
    if (relative.is_absolute() ||
        std::find(relative.begin(), relative.end(), "..") != relative.end()) {
      return Fail(ErrorKind::kData,
                  "{}: sensor \"{}\": mask: \"{}\", expected a file beside the rig",
                  rig_file.string(), sensor.name, name);
    }
    constexpr std::size_t kMaxMaskBytes = std::size_t{64} << 20U;
    OMNIHDR_ASSIGN(std::string mask, ReadTextFile(directory / relative, kMaxMaskBytes));
    files.push_back({name, std::move(mask)});
  }
  return files;
}

}  // namespace omnihdr
