#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include "core/session/rig_file.h"
#include "core/session/rig_import.h"

// The first byte chooses the kind of text (or leaves it to be told); a line "====" parts two files.
// Laws: any bytes give a rig or an error with a message; an imported rig is valid and its rig.toml
// reads back.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  if (size == 0) return 0;
  RigImportOptions options;
  switch (data[0]) {
    case 'c':
      options.kind = RigTextKind::kLadybugCsv;
      break;
    case 't':
      options.kind = RigTextKind::kLadybugText;
      options.width = 2448;
      options.height = 2048;
      break;
    case 'v':
      options.kind = RigTextKind::kVuzeYml;
      break;
    default:
      break;
  }
  std::string text(reinterpret_cast<const char*>(data) + 1, size - 1);
  std::vector<RigText> files;
  if (const std::size_t at = text.find("\n====\n"); at != std::string::npos) {
    files.push_back({"second", text.substr(at + 6)});
    text.resize(at + 1);
  }
  files.insert(files.begin(), {"first", text});
  const Result<Rig> rig = ImportRig(files, options);
  if (!rig) {
    if (rig.error().message.empty()) std::abort();
    return 0;
  }
  if (!rig->Validate() || !ParseRig(FormatRig(*rig), "rig.toml")) std::abort();
  return 0;
}
