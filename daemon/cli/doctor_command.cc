#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "daemon/cli/command.h"
#include "daemon/doctor/doctor.h"
#include "daemon/doctor/support_bundle.h"

namespace omnihdr {
namespace {

struct DoctorArguments {
  std::string config{kDefaultConfigFile};
  std::string user;
  double rate = 0.0;
  bool no_disk_test = false;
  bool json = false;
  std::string out;
  std::string session;
};

doctor::DoctorOptions DoctorOptionsOf(const DoctorArguments& arguments, bool config_given) {
  doctor::DoctorOptions options;
  options.config = arguments.config;
  options.config_must_exist = config_given;
  options.user = arguments.user;
  options.pictures_per_second = arguments.rate;
  options.measure_disk = !arguments.no_disk_test;
  return options;
}

Result<int> RunDoctor(const DoctorArguments& arguments, bool config_given) {
  const doctor::DoctorOptions options = DoctorOptionsOf(arguments, config_given);
  const std::vector<doctor::Diagnosis> found = doctor::Examine(options, doctor::RealMachine());
  const auto count = [&found](doctor::Verdict verdict) {
    return std::count_if(found.begin(), found.end(),
                         [verdict](const doctor::Diagnosis& d) { return d.verdict == verdict; });
  };
  const auto problems = count(doctor::Verdict::kProblem);
  const auto warnings = count(doctor::Verdict::kWarning);
  if (arguments.json) {
    nlohmann::ordered_json checks = nlohmann::ordered_json::array();
    for (const doctor::Diagnosis& d : found) {
      nlohmann::ordered_json check = {
          {"check", d.check}, {"verdict", ToString(d.verdict)}, {"found", d.found}};
      if (!d.remedy.empty()) check["remedy"] = d.remedy;
      checks.push_back(std::move(check));
    }
    const nlohmann::ordered_json json = {
        {"problems", problems}, {"warnings", warnings}, {"checks", checks}};
    fmt::print("{}\n", json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
  } else {
    for (const doctor::Diagnosis& d : found) {
      fmt::print("{:<8} {:<16} {}\n", ToString(d.verdict), d.check, d.found);
      if (!d.remedy.empty()) fmt::print("{:<8} {:<16} -> {}\n", "", "", d.remedy);
    }
    fmt::print("{} problem{}, {} warning{}\n", problems, problems == 1 ? "" : "s", warnings,
               warnings == 1 ? "" : "s");
  }
  return problems == 0 ? 0 : 1;
}

Result<int> MakeBundle(const DoctorArguments& arguments, bool config_given) {
  doctor::BundleOptions options;
  options.doctor = DoctorOptionsOf(arguments, config_given);
  options.out = arguments.out;
  options.session = arguments.session;
  OMNIHDR_ASSIGN(const doctor::BundleReport report,
                 doctor::WriteSupportBundle(options, doctor::RealMachine()));
  if (arguments.json) {
    const nlohmann::ordered_json json = {{"bundle", arguments.out},
                                         {"bytes", report.bytes},
                                         {"files", report.files},
                                         {"missing", report.missing}};
    fmt::print("{}\n", json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
    return 0;
  }
  for (const std::string& missing : report.missing) fmt::print("not in it: {}\n", missing);
  fmt::print("{}: {} files, {:.1f} kB; no pixels, no places, no passwords\n", arguments.out,
             report.files.size(), static_cast<double>(report.bytes) / 1e3);
  return 0;
}

}  // namespace

void AddDoctorCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "doctor",
      "What keeps the appliance from working, and what to type against it: configuration, camera, "
      "USB memory, GPIO lines, disk, clock, gpsd, Modbus, service; exit code 1 when there is a "
      "problem");
  auto arguments = std::make_shared<DoctorArguments>();
  CLI::Option* config =
      command->add_option("--config", arguments->config, "the daemon's configuration")
          ->capture_default_str();
  command->add_option("--user", arguments->user,
                      "for whom devices must be open (default: the caller; for root the service's "
                      "user, omnihdr)");
  command
      ->add_option("--rate", arguments->rate,
                   "pictures a second that the disk must take (default: as the trigger says)")
      ->check(CLI::Range(1e-3, 1e4));
  command->add_flag("--no-disk-test", arguments->no_disk_test,
                    "do not measure the disk: a few seconds of pictures written and removed");
  command->add_flag("--json", arguments->json, "one JSON object instead of lines for people");
  command->callback([arguments, config, &run] {
    run = [arguments, given = config->count() > 0] { return RunDoctor(*arguments, given); };
  });
}

void AddSupportBundleCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "support-bundle",
      "One file with what a helper far away needs: state, diagnosis, configuration without "
      "secrets, the end of log and journal, versions, facts of kernel and USB, headers of "
      "sessions; works when the daemon is down");
  auto arguments = std::make_shared<DoctorArguments>();
  command->add_option("--out", arguments->out, "the file to write, FILE.tar.gz")->required();
  CLI::Option* config =
      command->add_option("--config", arguments->config, "the daemon's configuration")
          ->capture_default_str();
  command->add_option("--session", arguments->session,
                      "the session to tell of (default: the newest in session.directory)");
  command->add_flag("--no-disk-test", arguments->no_disk_test, "do not measure the disk");
  command->add_flag("--json", arguments->json, "what is in it, as one JSON object");
  command->callback([arguments, config, &run] {
    run = [arguments, given = config->count() > 0] { return MakeBundle(*arguments, given); };
  });
}

}  // namespace omnihdr
