#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "daemon/doctor/doctor.h"

// The parts of Examine. Private to daemon/doctor.
namespace omnihdr::doctor {

// What the checks know and what they found so far.
struct Examination {
  const DoctorOptions& options;
  const Machine& machine;
  const DaemonConfig& config;
  Account account;
  bool daemon_answers = false;
  std::vector<Diagnosis> found;

  void Add(std::string check, Verdict verdict, std::string what, std::string remedy = {}) {
    found.push_back({std::move(check), verdict, std::move(what), std::move(remedy)});
  }
  void Good(std::string check, std::string what) {
    Add(std::move(check), Verdict::kGood, std::move(what));
  }
  void Problem(std::string check, std::string what, std::string remedy) {
    Add(std::move(check), Verdict::kProblem, std::move(what), std::move(remedy));
  }
  void Warning(std::string check, std::string what, std::string remedy) {
    Add(std::move(check), Verdict::kWarning, std::move(what), std::move(remedy));
  }
};

// A device node: there, open for the account, and held by whom. True when it can be used.
// `group` owns nodes of its kind; `missing` says what to do when there is none.
bool CheckNode(Examination& e, const std::string& check, const std::filesystem::path& path,
               const std::string& group, const std::string& missing);

void CheckCamera(Examination& e);   // camera, camera-controller, camera-rig, usb-memory
void CheckGpio(Examination& e);     // gpio-*
void CheckStorage(Examination& e);  // storage, storage-volume, storage-space, storage-speed
void CheckLinks(Examination& e);    // gnss, modbus-*

// Bytes of one picture of the configured camera before it is packed; nothing when only the camera
// knows.
std::optional<std::size_t> PictureBytes(const DaemonConfig& config);
// Pictures a second by the trigger; nothing when somebody else decides.
std::optional<double> PicturesPerSecond(const DoctorOptions& options, const DaemonConfig& config);

}  // namespace omnihdr::doctor
