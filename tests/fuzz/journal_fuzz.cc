#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "core/session/session_reader.h"

namespace {

std::string Written(const omnihdr::JournalContents& journal) {
  std::string text;
  for (const omnihdr::FrameRecord& frame : journal.frames) {
    text += omnihdr::FormatFrameRecord(frame) + "\n";
  }
  return text;
}

}  // namespace

// Laws: whatever is accepted as frames.jsonl is written back as a text that reads the same; a
// journal that was cut holds a beginning of the frames of the whole one, but for a last line that
// reads well as far as it goes: what came behind it may have spoilt it.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const Result<JournalContents> journal = ParseJournal(text, "frames.jsonl");
  if (!journal) {
    if (journal.error().message.empty()) std::abort();
    return 0;
  }
  if (journal->complete_bytes > size) std::abort();
  const std::string written = Written(*journal);
  const Result<JournalContents> again = ParseJournal(written, "frames.jsonl");
  if (!again || !again->rejected.empty() || Written(*again) != written) std::abort();

  Result<JournalContents> cut = ParseJournal(text.substr(0, size / 2), "frames.jsonl");
  if (!cut || written.starts_with(Written(*cut))) return 0;
  if (cut->frames.empty() || text[size / 2 - 1] == '\n') std::abort();
  cut->frames.pop_back();
  if (!written.starts_with(Written(*cut))) std::abort();
  return 0;
}
