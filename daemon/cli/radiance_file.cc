#include "daemon/cli/radiance_file.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "core/pipeline/view_files.h"

namespace omnihdr {

Status WriteRadianceFile(const std::string& file, const RadianceFile& content) {
  Image<float> origin(content.origin->width(), content.origin->height());
  std::copy(content.origin->values().begin(), content.origin->values().end(),
            origin.values().begin());
  ExrAttributes attributes = content.attributes;
  attributes.strings["software"] = "omnihdr " OMNIHDR_VERSION;
  attributes.strings["omnihdrOrigin"] = kOriginMeaning;
  attributes.chromaticities = kRec709;
  std::vector<ExrChannel> channels = {{"R", *content.radiance, content.type, 0},
                                      {"G", *content.radiance, content.type, 1},
                                      {"B", *content.radiance, content.type, 2},
                                      {"origin", origin, ExrPixelType::kHalf, 0}};
  if (content.disparity != nullptr) {
    channels.push_back({"disparity", *content.disparity, ExrPixelType::kFloat, 0});
  }
  return WriteExrAtomic(file, channels, attributes, ExrCompression::kPiz);
}

}  // namespace omnihdr
