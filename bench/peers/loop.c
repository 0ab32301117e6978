// Follows the spiral with a step that CasADi generated, and prints the quantiles of its times and the error of the tip.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "step.h"

static double now_us(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return 1e6 * time.tv_sec + 1e-3 * time.tv_nsec;
}

static int ascending(const void *a, const void *b) {
  double difference = *(const double *)a - *(const double *)b;
  return (difference > 0) - (difference < 0);
}

// Arguments: bends, steps of the horizon, cycles, repetitions. Input: the first bends, then the points of the curve.
int main(int count, char **text) {
  if (count != 5) return 2;
  int bends = atoi(text[1]), steps = atoi(text[2]), cycles = atoi(text[3]), repetitions = atoi(text[4]);
  double start[12], *curve = malloc(sizeof(double) * 3 * (cycles + steps + 1));
  double *times = malloc(sizeof(double) * cycles * repetitions), sum_m = 0;
  for (int i = 0; i < bends; i++) if (scanf("%lf", start + i) != 1) return 3;
  for (int i = 0; i < 3 * (cycles + steps); i++) if (scanf("%lf", curve + i) != 1) return 3;
  const double *arguments[step_SZ_ARG + tip_of_SZ_ARG];
  double *results[step_SZ_RES + tip_of_SZ_RES], work[step_SZ_W + tip_of_SZ_W + 1];
  casadi_int integers[step_SZ_IW + tip_of_SZ_IW + 1];
  for (int repetition = 0; repetition < repetitions; repetition++) {
    double q[12], rates[12] = {0}, next[12], tip[3];
    for (int i = 0; i < bends; i++) q[i] = start[i];
    for (int cycle = 0; cycle < cycles; cycle++) {
      double begin_us = now_us();
      arguments[0] = q, arguments[1] = rates, arguments[2] = curve + 3 * cycle;
      results[0] = next;
      step(arguments, results, integers, work, 0);
      times[repetition * cycles + cycle] = now_us() - begin_us;
      for (int i = 0; i < bends; i++) rates[i] = next[i], q[i] += 0.005 * next[i];
      arguments[0] = q, results[0] = tip;
      tip_of(arguments, results, integers, work, 0);
      double squares = 0;
      for (int i = 0; i < 3; i++) squares += pow(tip[i] - curve[3 * cycle + i], 2);
      sum_m += sqrt(squares);
    }
  }
  int all = cycles * repetitions;
  qsort(times, all, sizeof(double), ascending);
  printf("%g %g %g\n", times[all / 2], times[(int)(0.99 * all)], 1e3 * sum_m / all);
  return 0;
}
