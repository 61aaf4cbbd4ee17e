#include "drivers/firewire/firewire.h"

namespace omnihdr::firewire {

const char* ToString(Answer answer) {
  switch (answer) {
    case Answer::kComplete:
      return "complete";
    case Answer::kBusy:
      return "busy";
    case Answer::kConflict:
      return "conflict";
    case Answer::kReset:
      return "bus reset";
    case Answer::kRefused:
      return "refused";
    case Answer::kNoAnswer:
      return "no answer";
    case Answer::kGone:
      return "gone";
    case Answer::kFailed:
      return "failed";
  }
  return "?";
}

}  // namespace omnihdr::firewire
