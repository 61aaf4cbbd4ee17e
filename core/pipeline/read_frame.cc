#include "core/pipeline/read_frame.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/base/profile.h"

namespace omnihdr {

Result<DecodedImage> ReadFrame(const std::filesystem::path& session,
                               const CameraDescription& camera, const FrameRecord& record) {
  const std::filesystem::path path = session / record.file;
  const ProfileScope read_profile("read");
  OMNIHDR_ASSIGN(const std::vector<std::byte> bytes, ReadFile(path));
  if (record.crc32c) {
    const std::uint32_t crc = Crc32c(bytes);
    if (crc != *record.crc32c) {
      return Fail(ErrorKind::kData, "{}: crc32c {}, expected {} as journaled", path.string(), crc,
                  *record.crc32c);
    }
  }
  const ProfileScope decode_profile("decode");
  OMNIHDR_ASSIGN(DecodedImage image, DecodeImage(bytes, path.string()));
  if (image.width() != camera.width || image.height() != camera.height) {
    return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as session.json says", path.string(),
                image.width(), image.height(), camera.width, camera.height);
  }
  return image;
}

}  // namespace omnihdr
