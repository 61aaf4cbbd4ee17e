#include <CLI/CLI.hpp>
#include <memory>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "daemon/cli/command.h"
#include "daemon/evaluation/contact_sheet.h"

namespace omnihdr {
namespace {

struct ContactSheetArguments {
  std::string session;
  std::string out;
  std::string views;
  std::string reference;
  std::string mask;
  ContactSheetOptions options;
};

Result<int> ContactSheet(const ContactSheetArguments& arguments) {
  ContactSheetOptions options = arguments.options;
  options.evaluation.views = arguments.views;
  options.evaluation.photographs = arguments.reference;
  options.evaluation.mask.file = arguments.mask;
  OMNIHDR_ASSIGN(const Image<std::uint8_t> sheet, MakeContactSheet(arguments.session, options));
  OMNIHDR_ASSIGN(const std::vector<std::byte> png, EncodePng(sheet.view(), 6));
  OMNIHDR_TRY(WriteFileAtomic(arguments.out, png));
  return 0;
}

}  // namespace

void AddContactSheetCommand(CLI::App& app, CommandRun& run) {
  auto* command = app.add_subcommand(
      "contact-sheet",
      "Draw a session as one picture: input frames, views, disparity and, if known, errors");
  auto arguments = std::make_shared<ContactSheetArguments>();
  command->add_option("SESSION", arguments->session, "Session directory")->required();
  command->add_option("--out", arguments->out, "PNG file to write")->required();
  command->add_option("--views", arguments->views, "Folder of the views [SESSION/views]");
  command->add_option("--reference", arguments->reference,
                      "Folder of photographs with how.json [SESSION/reference, when there is one]");
  command->add_option("--mask", arguments->mask, "Picture the size of a frame: black is not shown");
  command
      ->add_option("--rows", arguments->options.rows,
                   "Positions shown at most; more are sampled evenly")
      ->check(CLI::Range(1, 200))
      ->capture_default_str();
  command
      ->add_option("--cell-width", arguments->options.cell_width, "Width of one picture in pixels")
      ->check(CLI::Range(64, 2048))
      ->capture_default_str();
  command->callback([arguments, &run] { run = [arguments] { return ContactSheet(*arguments); }; });
}

}  // namespace omnihdr
