#pragma once

#include <cmath>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <variant>
#include <vector>

#include "core/image/image_io.h"

// What is put together from OpenCV's parts for panoramas, as their users do it: the peers of whole
// stages and of the whole chain.
namespace omnihdr::opencv_parts {

struct Sift {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
};

// The same pixels as an OpenCV matrix (8 bits, three channels), not copied.
inline cv::Mat MatOf(const DecodedImage& image) {
  const auto& pixels = std::get<Image<std::uint8_t>>(image.pixels);
  return {pixels.height(), pixels.width(), CV_8UC3, const_cast<std::uint8_t*>(pixels.data())};
}

inline Sift FindSift(const cv::Mat& image, int count) {
  cv::Mat grey;
  cv::cvtColor(image, grey, cv::COLOR_RGB2GRAY);
  Sift sift;
  cv::SIFT::create(count)->detectAndCompute(grey, {}, sift.keypoints, sift.descriptors);
  return sift;
}

// Exact nearest neighbours with the ratio test.
inline std::vector<cv::DMatch> MatchSift(const Sift& a, const Sift& b) {
  std::vector<std::vector<cv::DMatch>> found;
  cv::BFMatcher(cv::NORM_L2).knnMatch(a.descriptors, b.descriptors, found, 2);
  std::vector<cv::DMatch> matches;
  for (const std::vector<cv::DMatch>& pair : found) {
    if (pair.size() == 2 && pair[0].distance < 0.8F * pair[1].distance) matches.push_back(pair[0]);
  }
  return matches;
}

// Relative pose by findEssentialMat, which knows pinhole cameras only: of the features ahead, on
// the plane before the camera. False when there are too few.
inline bool RelativePoseOf(const Sift& a, const Sift& b, const std::vector<cv::DMatch>& matches,
                           int width, cv::Matx33d* rotation, cv::Vec3d* direction) {
  const auto plane = [width](const cv::KeyPoint& key, cv::Point2d* point) {
    const double theta = std::numbers::pi * (1.0 - 2.0 * key.pt.x / width);
    const double phi = 2.0 * std::numbers::pi * key.pt.y / width;
    const double ahead = std::sin(phi) * std::cos(theta);
    if (ahead < 0.4) return false;
    *point = {-std::sin(phi) * std::sin(theta) / ahead, -std::cos(phi) / ahead};
    return true;
  };
  std::vector<cv::Point2d> from;
  std::vector<cv::Point2d> to;
  for (const cv::DMatch& match : matches) {
    cv::Point2d p;
    cv::Point2d q;
    if (!plane(a.keypoints[static_cast<std::size_t>(match.queryIdx)], &p) ||
        !plane(b.keypoints[static_cast<std::size_t>(match.trainIdx)], &q)) {
      continue;
    }
    from.push_back(p);
    to.push_back(q);
  }
  if (from.size() < 8) return false;
  const cv::Mat identity = cv::Mat::eye(3, 3, CV_64F);
  cv::Mat inliers;
  const cv::Mat essential =
      cv::findEssentialMat(from, to, identity, cv::RANSAC, 0.999, 2e-3, inliers);
  if (essential.rows != 3) return false;
  cv::Mat r;
  cv::Mat t;
  cv::recoverPose(essential, from, to, identity, r, t, inliers);
  *rotation = r;
  *direction = {t.at<double>(0), t.at<double>(1), t.at<double>(2)};
  return true;
}

inline cv::Ptr<cv::StereoSGBM> Matcher(int disparities, int mode) {
  constexpr int kBlock = 5;
  return cv::StereoSGBM::create(0, disparities, kBlock, 8 * kBlock * kBlock, 32 * kBlock * kBlock,
                                1, 0, 10, 0, 0, mode);
}

}  // namespace omnihdr::opencv_parts
