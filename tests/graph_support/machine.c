/*
 * Preloaded into processes: somebody sets the time of their machine, and its disk is slow.
 *
 * The file that MACHINE names holds two 64-bit numbers: what is added to the time of day, ns, and
 * how long each write to a file takes longer, us. A wait that ends at a time of day ends when the
 * clock that was set reaches it, as on a real machine.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define S INT64_C(1000000000)
#define STEP (S / 20)  // ns between looks at the clock while something waits
#define MONOTONIC_CONDITION 2  // flag of a condition variable that waits by that clock, in glibc

struct machine {
  int64_t set_ns;
  int64_t write_us;
};

static const volatile struct machine usual;
static const volatile struct machine *machine = &usual;

__attribute__((constructor)) static void begin(void) {
  int file = open(getenv("MACHINE"), O_RDONLY);
  void *place = mmap(NULL, sizeof *machine, PROT_READ, MAP_SHARED, file, 0);
  if (place == MAP_FAILED) abort();
  machine = place;
  close(file);
}

static int64_t ns(const struct timespec *time) { return time->tv_sec * S + time->tv_nsec; }

static struct timespec timespec(int64_t ns) { return (struct timespec){ns / S, ns % S}; }

int clock_gettime(clockid_t clock, struct timespec *now) {
  static __typeof__(&clock_gettime) real;
  if (real == NULL) real = REAL(clock_gettime);
  int failed = real(clock, now);
  if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
    *now = timespec(ns(now) + machine->set_ns);
  return failed;
}

static int64_t now(clockid_t clock) {
  struct timespec now;
  clock_gettime(clock, &now);
  return ns(&now);
}

int gettimeofday(struct timeval *restrict time, void *restrict zone) {
  int64_t day = now(CLOCK_REALTIME);
  time->tv_sec = day / S;
  time->tv_usec = day % S / 1000;
  return 0;
}

/* Waits by small steps until a time of day has come by the clock that may be set meanwhile. */
#define WAIT_UNTIL(until, wait)                                             \
  for (;;) {                                                                \
    int64_t left = ns(until) - now(CLOCK_REALTIME);                         \
    left = left < 0 ? 0 : left < STEP ? left : STEP;                        \
    struct timespec next = timespec(now(CLOCK_MONOTONIC) + left);           \
    int failed = wait;                                                      \
    if (failed != ETIMEDOUT || now(CLOCK_REALTIME) >= ns(until)) return failed; \
  }

int pthread_cond_timedwait(
    pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
    const struct timespec *restrict until) {
  if (condition->__data.__wrefs & MONOTONIC_CONDITION)
    return pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, until);
  WAIT_UNTIL(until, pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, &next))
}

int pthread_mutex_timedlock(
    pthread_mutex_t *restrict mutex, const struct timespec *restrict until) {
  WAIT_UNTIL(until, pthread_mutex_clocklock(mutex, CLOCK_MONOTONIC, &next))
}

static int failure(int failed) { return failed ? errno : 0; }

static int wait_for_semaphore(sem_t *semaphore, const struct timespec *until) {
  WAIT_UNTIL(until, failure(sem_clockwait(semaphore, CLOCK_MONOTONIC, &next)))
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict until) {
  int failed = wait_for_semaphore(semaphore, until);
  if (failed) errno = failed;
  return failed ? -1 : 0;
}

static void wait_for_disk(int file) {
  struct stat kind;
  if (machine->write_us && !fstat(file, &kind) && S_ISREG(kind.st_mode)) usleep(machine->write_us);
}

ssize_t write(int file, const void *data, size_t size) {
  static __typeof__(&write) real;
  if (real == NULL) real = REAL(write);
  wait_for_disk(file);
  return real(file, data, size);
}

int fsync(int file) {
  static __typeof__(&fsync) real;
  if (real == NULL) real = REAL(fsync);
  wait_for_disk(file);
  return real(file);
}
