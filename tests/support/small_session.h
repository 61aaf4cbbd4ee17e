#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "core/session/journal.h"
#include "core/session/session.h"
#include "tests/support/room.h"

namespace omnihdr::testing {

// What a small recorded drive through a room looks like.
struct SessionPlan {
  Room room;
  std::vector<Pose> poses;                             // one a position
  std::vector<double> exposures_s = {0.25, 0.5, 1.0};  // one a position, in turn
  Projection projection = Projection::Equirectangular(256, 128);
  bool with_prior_poses = false;  // the journal tells the poses: nothing to estimate
  bool with_odometer = true;
  bool with_heading = false;    // the poses' turn about the vertical, as a compass bearing
  int frames_per_position = 1;  // as session.json says; 0: it says nothing
  NoiseModel noise;
};

// Poses along a gently bending line, `step` metres apart, the first at the origin.
std::vector<Pose> GentleBend(int positions, double step);

// The session's frames as PNG files, one a position.
std::vector<std::vector<std::byte>> RenderFrames(const SessionPlan& plan);

SessionInfo InfoOf(const SessionPlan& plan);
FrameRecord RecordOf(const SessionPlan& plan, std::size_t position);

// A whole session of the first `count` frames (all: -1).
void WriteSession(const std::filesystem::path& directory, const SessionPlan& plan,
                  const std::vector<std::vector<std::byte>>& frames, int count = -1);

// Every file of DIRECTORY/views by its path there, and its content.
std::map<std::string, std::string> ViewBytes(const std::filesystem::path& directory);

std::string FileText(const std::filesystem::path& path);
void WriteText(const std::filesystem::path& path, const std::string& text);

}  // namespace omnihdr::testing
