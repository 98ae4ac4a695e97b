/* Our steps from C that has arrays of its own: they are read, and written, where they are. */

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

void ours_planar5(void *self, const double *q, const double *given, double *result) {
  const double *arg[] = {
      q,
      &planar5_in.obstacles_gain,
      &planar5_in.obstacles_damping,
      given,     /* reference */
      given + 2, /* its velocity */
      &planar5_in.tool_gain[0][0],
      &planar5_in.tool_damping,
      given + 4, /* centres of the obstacles */
      planar5_in.obstacle_radius,
      &planar5_in.obstacle_count,
      planar5_in.influence_radius,
      planar5_in.filter_cutoff,
      &planar5_in.lam_free,
      &planar5_in.lam_event,
      &planar5_in.period,
  };
  double *res[] = {
      result,      /* q_next */
      result + 5,  /* dq */
      result + 10, /* dq_law */
      result + 15, /* potential */
      result + 16, /* position of the tool */
      result + 18, /* its error */
      result + 20, /* lambda */
      result + 21, /* active */
      result + 22, /* distances */
      result + 28, /* clearance */
  };
  (void)self;
  planar5_step(arg, res, 0, 0, 0);
}

void ours_arm7(void *self, const double *q, const double *given, double *result) {
  static arm7_step_output rest;
  const double *arg[] = {
      q,
      given,      /* position */
      given + 3,  /* velocity */
      given + 6,  /* orientation */
      given + 10, /* angular velocity */
      &arm7_in.hand_gain[0][0],
      &arm7_in.hand_damping,
      arm7_in.posture_reference,
      arm7_in.posture_reference_velocity,
      arm7_in.posture_gain,
      &arm7_in.posture_damping,
      arm7_in.filter_cutoff,
      &arm7_in.lam_free,
      &arm7_in.period,
  };
  double *res[] = {
      result,      /* q_next */
      result + 7,  /* dq */
      result + 14, /* dq_law */
      result + 21, /* position of the hand */
      result + 24, /* its orientation */
      result + 28, /* what is missing */
      result + 31, /* and how much it is to turn */
      rest.posture_value,
      rest.posture_error,
      &rest.lam,
  };
  (void)self;
  arm7_step(arg, res, 0, 0, 0);
}
