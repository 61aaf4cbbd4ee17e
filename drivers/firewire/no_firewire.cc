#include "drivers/firewire/firewire.h"

namespace omnihdr::firewire {
namespace {

class NoBus final : public Bus {
 public:
  Result<std::vector<NodeInfo>> List() override { return Why(); }
  Result<std::unique_ptr<Node>> Open(const NodeInfo& /*info*/) override { return Why(); }

 private:
  static tl::unexpected<Error> Why() {
    return Fail(ErrorKind::kConfig,
                "FireWire: this program was built without it: expected -DOMNIHDR_FIREWIRE=ON");
  }
};

}  // namespace

std::unique_ptr<Bus> MakeSystemBus() { return std::make_unique<NoBus>(); }

}  // namespace omnihdr::firewire
