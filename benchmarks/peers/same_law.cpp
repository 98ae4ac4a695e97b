// The laws of planar5 and of arm7 with Pinocchio and Eigen, as their users write them: matrices of fixed size, data
// made once, what is constant worked out beforehand, the avoidance of points in contact only. Twice: with frames and
// their Jacobians, which is what Pinocchio offers, and by hand from the placements and the Jacobian of the joints,
// which is more work to write and less to compute. Results in the order of ours.c.

#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include <Eigen/Dense>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/spatial.hpp>

namespace {

using Eigen::Map;
using Eigen::Matrix;
using Eigen::Vector2d;
using Eigen::Vector3d;
using pinocchio::FrameIndex;
using pinocchio::LOCAL_WORLD_ALIGNED;

template <int size> using Vector = Matrix<double, size, 1>;
template <int size> using Given = Map<const Vector<size>>;

template <int size> Map<Vector<size>> out(double *at) { return Map<Vector<size>>(at); }

enum Kind { slide_x, slide_y, turn_z };

// twelve numbers: a rotation row by row, then a position
pinocchio::SE3 placement(const double *numbers) {
  return {Map<const Matrix<double, 3, 3, Eigen::RowMajor>>(numbers), Map<const Vector3d>(numbers + 9)};
}

struct Chain {
  pinocchio::Model model;
  std::vector<FrameIndex> frames;
  std::vector<int> joints;  // how many move each frame
  std::vector<Vector3d> offsets;

  Chain(int joints, const int *kinds, const double *places, int count, const int *parents, const double *frame_places) {
    pinocchio::JointIndex last = 0;
    for (int i = 0; i < joints; ++i) {
      const auto place = placement(places + 12 * i);
      const auto name = "joint" + std::to_string(i);
      if (kinds[i] == slide_x) last = model.addJoint(last, pinocchio::JointModelPX(), place, name);
      if (kinds[i] == slide_y) last = model.addJoint(last, pinocchio::JointModelPY(), place, name);
      if (kinds[i] == turn_z) last = model.addJoint(last, pinocchio::JointModelRZ(), place, name);
    }
    for (int i = 0; i < count; ++i) {
      const auto place = placement(frame_places + 12 * i);
      const pinocchio::JointIndex parent = parents[i];
      frames.push_back(
          model.addFrame(pinocchio::Frame("frame" + std::to_string(i), parent, place, pinocchio::OP_FRAME)));
      this->joints.push_back(parents[i]);
      offsets.push_back(place.translation());
    }
  }
};

// beta of eq. 15
double filter(double period, double cutoff) {
  const double x = 2 * std::numbers::pi * period * cutoff;
  return x / (1 + x);
}

template <bool by_hand> class Planar5 {
  static constexpr int n = 5, points = 6, obstacles = 3;
  static constexpr double period = 0.01, tool_gain = 4, tool_damping = 1e-3, gain = 250, damping = 1e-9;
  const double beta = filter(period, 4);

  Chain chain;
  pinocchio::Data data{chain.model};
  std::array<Matrix<double, 6, n>, points> J;  // of every point; columns of joints beyond it stay zero
  Matrix<double, obstacles, 1> radius;
  Vector<points> influence;

public:
  Planar5(Chain given, const double *radii, const double *influence_radii)
      : chain(std::move(given)), radius(radii), influence(influence_radii) {
    for (auto &one : J) one.setZero();
  }

  void step(const double *q_, const double *given, double *result) {
    const Vector<n> q = Given<n>(q_);
    const Given<2> reference(given), reference_velocity(given + 2);
    const Map<const Matrix<double, 2, obstacles>> centers(given + 4);
    pinocchio::computeJointJacobians(chain.model, data, q);

    constexpr int tool = points - 1;  // the last point of interest is the tool
    const Vector2d position = place(tool);
    const Vector2d error = reference - position;
    const Matrix<double, 2, n> J_g = jacobian(tool, position);
    Eigen::Matrix2d gram = J_g * J_g.transpose();
    gram.diagonal().array() += tool_damping * tool_damping;
    Vector<n> dq_law = J_g.transpose() * (gram.inverse() * (reference_velocity + tool_gain * error));

    double potential = 0, clearance = INFINITY;
    Vector<points> distance;
    Vector<n> J_o = Vector<n>::Zero();
    for (int i = 0; i < points; ++i) {
      const Vector2d point = i == tool ? position : place(i);
      Vector2d toward = Vector2d::Zero();
      double length = 0;
      distance[i] = INFINITY;
      for (int k = 0; k < obstacles; ++k) {
        const Vector2d to = centers.col(k) - point;
        const double norm = to.norm();
        if (norm - radius[k] < distance[i]) {
          distance[i] = norm - radius[k];
          toward = to;
          length = norm;
        }
      }
      const double depth = influence[i] - distance[i];
      clearance = std::min(clearance, -depth);
      if (depth > 0) {
        potential += depth * depth / 2;
        push(J_o, i, point, depth / length * toward);
      }
    }
    const bool active = clearance <= 0;
    if (active) dq_law -= J_o * ((gain * potential + J_o.dot(dq_law)) / (J_o.squaredNorm() + damping * damping));

    const Vector<n> dq = active ? beta * dq_law : dq_law;
    out<n>(result) = q + period * dq;
    out<n>(result + n) = dq;
    out<n>(result + 2 * n) = dq_law;
    result += 3 * n;
    result[0] = potential;
    out<2>(result + 1) = position;
    out<2>(result + 3) = error;
    result[5] = active;  // lambda
    result[6] = active;
    out<points>(result + 7) = distance;
    result[7 + points] = clearance;
  }

private:
  Vector2d place(int i) {
    if constexpr (by_hand) return data.oMi[chain.joints[i]].act(chain.offsets[i]).template head<2>();
    return pinocchio::updateFramePlacement(chain.model, data, chain.frames[i]).translation().template head<2>();
  }

  Matrix<double, 2, n> jacobian(int i, const Vector2d &at) {
    if constexpr (by_hand) {
      Matrix<double, 2, n> found = data.J.template topRows<2>();
      found.row(0) -= at.y() * data.J.row(5);  // all motion is in the plane
      found.row(1) += at.x() * data.J.row(5);
      return found;
    }
    return frame_jacobian(i).template topRows<2>();
  }

  // adds what the force at the point does to the joints
  void push(Vector<n> &total, int i, const Vector2d &at, const Vector2d &force) {
    if constexpr (by_hand) {
      const double moment = at.x() * force.y() - at.y() * force.x();
      for (int k = 0; k < chain.joints[i]; ++k)
        total[k] += data.J(0, k) * force.x() + data.J(1, k) * force.y() + data.J(5, k) * moment;
    } else {
      total += frame_jacobian(i).template topRows<2>().transpose() * force;
    }
  }

  const Matrix<double, 6, n> &frame_jacobian(int i) {
    pinocchio::getFrameJacobian(chain.model, data, chain.frames[i], LOCAL_WORLD_ALIGNED, J[i]);
    return J[i];
  }
};

template <bool by_hand> class Arm7 {
  static constexpr int n = 7;
  static constexpr double period = 0.002, hand_gain = 20, hand_damping = 1e-2, posture_gain = 1, posture_damping = 1e-2;

  Chain chain;
  pinocchio::Data data{chain.model};
  Matrix<double, 6, n> J = Matrix<double, 6, n>::Zero();
  Vector<n> posture;

public:
  Arm7(Chain given, const double *q) : chain(std::move(given)), posture(q) {}

  void step(const double *q_, const double *given, double *result) {
    const Vector<n> q = Given<n>(q_);
    const Given<3> reference(given), velocity(given + 3), angular_velocity(given + 10);
    const Eigen::Quaterniond turned(given[6], given[7], given[8], given[9]);
    pinocchio::computeJointJacobians(chain.model, data, q);
    const FrameIndex hand = chain.frames[0];
    const pinocchio::SE3 &pose = pinocchio::updateFramePlacement(chain.model, data, hand);
    if constexpr (by_hand) {
      J = data.J;
      for (int k = 0; k < n; ++k) J.col(k).template head<3>() += J.col(k).template tail<3>().cross(pose.translation());
    } else {
      pinocchio::getFrameJacobian(chain.model, data, hand, LOCAL_WORLD_ALIGNED, J);
    }

    const Vector3d error = reference - pose.translation();
    const Vector3d turn =
        pinocchio::log3((turned.normalized().toRotationMatrix() * pose.rotation().transpose()).eval());
    Vector<6> wanted;
    wanted << velocity + hand_gain * error, angular_velocity + hand_gain * turn;

    Vector<n> dq_law = posture_gain / (1 + posture_damping * posture_damping) * (posture - q);
    Matrix<double, 6, 6> gram = J * J.transpose();
    gram.diagonal().array() += hand_damping * hand_damping;
    wanted.noalias() -= J * dq_law;
    dq_law.noalias() += J.transpose() * gram.llt().solve(wanted);

    out<n>(result) = q + period * dq_law;
    out<n>(result + n) = dq_law;
    out<n>(result + 2 * n) = dq_law;
    result += 3 * n;
    out<3>(result) = pose.translation();
    const Eigen::Quaterniond orientation(pose.rotation());
    const double sign = orientation.w() < 0 ? -1 : 1;
    result[3] = sign * orientation.w();
    out<3>(result + 4) = sign * orientation.vec();
    out<3>(result + 7) = error;
    out<3>(result + 10) = turn;
  }
};

}  // namespace

using Step = void (*)(void *, const double *, const double *, double *);

template <class Robot> void step(void *self, const double *q, const double *given, double *result) {
  static_cast<Robot *>(self)->step(q, given, result);
}

extern "C" {

void *planar5_new(int by_hand, int joints, const int *kinds, const double *places, int frames, const int *parents,
                  const double *frame_places, const double *radii, const double *influence_radii) {
  Chain chain(joints, kinds, places, frames, parents, frame_places);
  if (by_hand) return new Planar5<true>(std::move(chain), radii, influence_radii);
  return new Planar5<false>(std::move(chain), radii, influence_radii);
}

Step planar5_step(int by_hand) { return by_hand ? step<Planar5<true>> : step<Planar5<false>>; }

void *arm7_new(int by_hand, int joints, const int *kinds, const double *places, int frames, const int *parents,
               const double *frame_places, const double *posture) {
  Chain chain(joints, kinds, places, frames, parents, frame_places);
  if (by_hand) return new Arm7<true>(std::move(chain), posture);
  return new Arm7<false>(std::move(chain), posture);
}

Step arm7_step(int by_hand) { return by_hand ? step<Arm7<true>> : step<Arm7<false>>; }
}
