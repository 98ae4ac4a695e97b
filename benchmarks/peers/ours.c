/* Our steps as a user calls them from C: fill in the inputs that change, call, take the outputs. */

#include <string.h>

#include "arm7.h"
#include "planar5.h"

static planar5_step_input planar5_in;
static arm7_step_input arm7_in;

void ours_prepare(const double *obstacle_radius, const double *posture) {
  planar5_step_defaults(&planar5_in);
  memcpy(planar5_in.obstacle_radius, obstacle_radius, sizeof planar5_in.obstacle_radius);
  planar5_in.obstacle_count = PLANAR5_OBSTACLES;
  arm7_step_defaults(&arm7_in);
  memcpy(arm7_in.posture_reference, posture, sizeof arm7_in.posture_reference);
}

#define TAKE(target) (memcpy((target), given, sizeof(target)), given += sizeof(target) / sizeof(double))
#define GIVE(source) (memcpy(result, (source), sizeof(source)), result += sizeof(source) / sizeof(double))

void ours_planar5(void *self, const double *q, const double *given, double *result) {
  planar5_step_output out;
  (void)self;
  memcpy(planar5_in.q, q, sizeof planar5_in.q);
  TAKE(planar5_in.tool_reference);
  TAKE(planar5_in.tool_reference_velocity);
  TAKE(planar5_in.obstacle_center);
  planar5_step_call(&planar5_in, &out);
  GIVE(out.q_next);
  GIVE(out.dq);
  GIVE(out.dq_law);
  *result++ = out.obstacles_potential;
  GIVE(out.tool_position);
  GIVE(out.tool_error);
  *result++ = out.lam;
  *result++ = out.active;
  GIVE(out.distance);
  *result++ = out.clearance;
}

void ours_arm7(void *self, const double *q, const double *given, double *result) {
  arm7_step_output out;
  (void)self;
  memcpy(arm7_in.q, q, sizeof arm7_in.q);
  TAKE(arm7_in.hand_reference);
  TAKE(arm7_in.hand_reference_velocity);
  TAKE(arm7_in.hand_orientation_reference);
  TAKE(arm7_in.hand_orientation_reference_velocity);
  arm7_step_call(&arm7_in, &out);
  GIVE(out.q_next);
  GIVE(out.dq);
  GIVE(out.dq_law);
  GIVE(out.hand_position);
  GIVE(out.hand_orientation);
  GIVE(out.hand_error);
  GIVE(out.hand_orientation_error);
}
