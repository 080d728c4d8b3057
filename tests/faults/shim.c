// SPDX-License-Identifier: Apache-2.0
/* Faults at writes, preloaded into a program and all that it starts.
 *
 * Whatever changes something below a folder is counted over all processes; one of these calls fails, or writes
 * half of what it was given. By the environment:
 *
 *   FAULT_ROOT     the folder
 *   FAULT_COUNT    a file with the count, shared by all processes
 *   FAULT_LOG      a file that takes a line for each call (when recording) or for each fault made
 *   FAULT_AT       number of the call that fails; 0 records
 *   FAULT_CALL     counts calls of this name alone, when given
 *   FAULT_MATCH    counts paths of this form alone (fnmatch, from the folder), when given
 *   FAULT_HOW      ENOSPC, EIO, EROFS, EDQUOT, or short
 *   FAULT_LASTING  1: every later call fails too that would on such a disk
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <fnmatch.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

struct shared {
  atomic_long counted; /* calls so far */
  atomic_int broken;   /* whether a lasting fault has begun */
};

static struct shared *shared;
static char root[PATH_MAX];
static size_t root_length;
static const char *only_call, *only_match;
static long fail_at;
static int how, is_short, lasting, log_file = -1;

#define REAL(name) ({ static __typeof__(&name) real; if (!real) real = dlsym(RTLD_NEXT, #name); real; })

static const char *given_or_null(const char *name) {
  const char *value = getenv(name);
  return value && *value ? value : NULL;
}

/* Not atol: built on a newer system it would ask for a library that older images lack. */
static long number_of(const char *text) {
  long value = 0;
  for (; text && *text >= '0' && *text <= '9'; text++) value = 10 * value + (*text - '0');
  return value;
}

/* Called when a program begins, and by forks of a program that shall have faults of their own. */
__attribute__((constructor)) void fault_begin(void) {
  shared = NULL;
  const char *given = getenv("FAULT_ROOT"), *count = getenv("FAULT_COUNT"), *log = getenv("FAULT_LOG");
  if (!given || !count || !log) return;
  snprintf(root, sizeof root, "%s/", given);
  root_length = strlen(root);
  int file = syscall(SYS_openat, AT_FDCWD, count, O_RDWR | O_CLOEXEC);
  if (file < 0) return;
  void *place = mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  syscall(SYS_close, file);
  if (place == MAP_FAILED) return;
  const char *kind = getenv("FAULT_HOW"), *at = getenv("FAULT_AT"), *last = getenv("FAULT_LASTING");
  only_call = given_or_null("FAULT_CALL");
  only_match = given_or_null("FAULT_MATCH");
  fail_at = number_of(at);
  lasting = last && *last == '1';
  if (!kind) kind = "";
  is_short = !strcmp(kind, "short");
  how = !strcmp(kind, "EIO") ? EIO : !strcmp(kind, "EROFS") ? EROFS : !strcmp(kind, "EDQUOT") ? EDQUOT : ENOSPC;
  int opened = syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (opened >= 0) { /* out of the way of programs that close or count descriptors */
    log_file = syscall(SYS_fcntl, opened, F_DUPFD_CLOEXEC, 800);
    if (log_file < 0) log_file = opened; else syscall(SYS_close, opened);
  }
  shared = place;
}

static void note(const char *call, const char *path, const char *what) {
  char line[PATH_MAX + 100];
  int length = snprintf(line, sizeof line, "%s\t%s\t%s\t%d\n", call, path + root_length, what, (int)getpid());
  if (log_file >= 0) syscall(SYS_write, log_file, line, (size_t)length);
}

static const char *error_name(void) {
  return is_short ? "short" : how == EIO ? "EIO" : how == EROFS ? "EROFS" : how == EDQUOT ? "EDQUOT" : "ENOSPC";
}

/* Whether such a call fails on a disk that is full, or over its quota, or read-only, or broken. */
static int would_fail(const char *call) {
  if (how == EIO || how == EROFS) return 1;
  return strcmp(call, "unlink") && strcmp(call, "rmdir") && strcmp(call, "rename") && strcmp(call, "ftruncate") &&
         strcmp(call, "truncate") && strcmp(call, "fsync") && strcmp(call, "fdatasync") && strcmp(call, "chmod") &&
         strcmp(call, "utime") && strcmp(call, "open");
}

enum { GO_ON, FAIL, HALF };

/* Decide about one call on a path: go on, fail with errno set, or do half. */
static int judge(const char *call, const char *path, size_t size) {
  if (!shared || strncmp(path, root, root_length)) return GO_ON;
  const char *inside = path + root_length;
  if (fail_at && atomic_load(&shared->broken)) {
    if (!would_fail(call)) return GO_ON;
    note(call, path, error_name());
    errno = how;
    return FAIL;
  }
  if (only_call && strcmp(only_call, call)) return GO_ON;
  if (only_match && fnmatch(only_match, inside, 0)) return GO_ON;
  if (is_short && size < 2) return GO_ON;
  long number = atomic_fetch_add(&shared->counted, 1) + 1;
  if (!fail_at) {
    note(call, path, size > 1 ? "sized" : "-");
    return GO_ON;
  }
  if (number != fail_at) return GO_ON;
  if (lasting) atomic_store(&shared->broken, 1);
  note(call, path, error_name());
  if (is_short) return HALF;
  errno = how;
  return FAIL;
}

static const char *path_of(int fd, char *buffer) {
  char link[40];
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t length = syscall(SYS_readlink, link, buffer, PATH_MAX - 1);
  buffer[length > 0 ? length : 0] = 0;
  return buffer;
}

static const char *path_at(int folder, const char *path, char *buffer) {
  if (path[0] == '/') return path;
  char start[PATH_MAX];
  if (folder == AT_FDCWD) {
    if (syscall(SYS_getcwd, start, sizeof start) < 0) return path;
  } else path_of(folder, start);
  if (snprintf(buffer, PATH_MAX, "%s/%s", start, path) >= PATH_MAX) return path;
  return buffer;
}

static int judge_fd(const char *call, int fd, size_t size) {
  char buffer[PATH_MAX];
  int before = errno;
  if (!shared) return GO_ON;
  int found = judge(call, path_of(fd, buffer), size);
  if (found != FAIL) errno = before;
  return found;
}

static int judge_at(const char *call, int folder, const char *path) {
  char buffer[PATH_MAX];
  int before = errno;
  if (!shared || !path) return GO_ON;
  int found = judge(call, path_at(folder, path, buffer), 0);
  if (found != FAIL) errno = before;
  return found;
}

#define WRITES(name, parameters, arguments, halved) \
  ssize_t name parameters { \
    switch (judge_fd("write", fd, size)) { \
      case FAIL: return -1; \
      case HALF: size /= 2; return REAL(name) halved; \
      default: return REAL(name) arguments; \
    } \
  }

WRITES(write, (int fd, const void *data, size_t size), (fd, data, size), (fd, data, size))
WRITES(pwrite, (int fd, const void *data, size_t size, off_t at), (fd, data, size, at), (fd, data, size, at))
WRITES(pwrite64, (int fd, const void *data, size_t size, off64_t at), (fd, data, size, at), (fd, data, size, at))

static ssize_t half_of(int fd, const struct iovec *parts, int count) {
  for (int k = 0; k < count; k++)
    if (parts[k].iov_len > 1) return REAL(write)(fd, parts[k].iov_base, parts[k].iov_len / 2);
  return REAL(writev)(fd, parts, count);
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
  switch (judge_fd("write", fd, count > 0 ? parts[0].iov_len : 0)) {
    case FAIL: return -1;
    case HALF: return half_of(fd, parts, count);
    default: return REAL(writev)(fd, parts, count);
  }
}

#define COPIES(name, parameters, arguments) \
  ssize_t name parameters { \
    int found = judge_fd("write", to, size); \
    if (found == FAIL) return -1; \
    if (found == HALF && size > 65536) size = 65536; \
    return REAL(name) arguments; \
  }

COPIES(sendfile, (int to, int from, off_t *at, size_t size), (to, from, at, size))
COPIES(sendfile64, (int to, int from, off64_t *at, size_t size), (to, from, at, size))
COPIES(copy_file_range, (int from, off64_t *in, int to, off64_t *at, size_t size, unsigned flags),
       (from, in, to, at, size, flags))

#define ON_FILE(name, call, parameters, arguments) \
  int name parameters { return judge_fd(call, fd, 0) == FAIL ? -1 : REAL(name) arguments; }

ON_FILE(fsync, "fsync", (int fd), (fd))
ON_FILE(fdatasync, "fsync", (int fd), (fd))
ON_FILE(ftruncate, "ftruncate", (int fd, off_t size), (fd, size))
ON_FILE(ftruncate64, "ftruncate", (int fd, off64_t size), (fd, size))
ON_FILE(fallocate, "fallocate", (int fd, int mode, off_t at, off_t size), (fd, mode, at, size))
ON_FILE(fallocate64, "fallocate", (int fd, int mode, off64_t at, off64_t size), (fd, mode, at, size))
ON_FILE(fchmod, "chmod", (int fd, mode_t mode), (fd, mode))
ON_FILE(futimens, "utime", (int fd, const struct timespec times[2]), (fd, times))

/* These two return the error. */
int posix_fallocate(int fd, off_t at, off_t size) {
  return judge_fd("fallocate", fd, 0) == FAIL ? errno : REAL(posix_fallocate)(fd, at, size);
}
int posix_fallocate64(int fd, off64_t at, off64_t size) {
  return judge_fd("fallocate", fd, 0) == FAIL ? errno : REAL(posix_fallocate64)(fd, at, size);
}

#define ON_PATH(name, call, folder, path, parameters, arguments) \
  int name parameters { return judge_at(call, folder, path) == FAIL ? -1 : REAL(name) arguments; }

ON_PATH(mkdir, "mkdir", AT_FDCWD, path, (const char *path, mode_t mode), (path, mode))
ON_PATH(mkdirat, "mkdir", at, path, (int at, const char *path, mode_t mode), (at, path, mode))
ON_PATH(rmdir, "rmdir", AT_FDCWD, path, (const char *path), (path))
ON_PATH(unlink, "unlink", AT_FDCWD, path, (const char *path), (path))
ON_PATH(unlinkat, flags & AT_REMOVEDIR ? "rmdir" : "unlink", at, path, (int at, const char *path, int flags),
        (at, path, flags))
ON_PATH(rename, "rename", AT_FDCWD, to, (const char *from, const char *to), (from, to))
ON_PATH(renameat, "rename", at2, to, (int at, const char *from, int at2, const char *to), (at, from, at2, to))
ON_PATH(renameat2, "rename", at2, to, (int at, const char *from, int at2, const char *to, unsigned flags),
        (at, from, at2, to, flags))
ON_PATH(link, "link", AT_FDCWD, to, (const char *from, const char *to), (from, to))
ON_PATH(linkat, "link", at2, to, (int at, const char *from, int at2, const char *to, int flags),
        (at, from, at2, to, flags))
ON_PATH(symlink, "symlink", AT_FDCWD, path, (const char *to, const char *path), (to, path))
ON_PATH(symlinkat, "symlink", at, path, (const char *to, int at, const char *path), (to, at, path))
ON_PATH(chmod, "chmod", AT_FDCWD, path, (const char *path, mode_t mode), (path, mode))
ON_PATH(fchmodat, "chmod", at, path, (int at, const char *path, mode_t mode, int flags), (at, path, mode, flags))
ON_PATH(truncate, "truncate", AT_FDCWD, path, (const char *path, off_t size), (path, size))

int utimensat(int at, const char *path, const struct timespec times[2], int flags) {
  return judge_at("utime", at, path) == FAIL ? -1 : REAL(utimensat)(at, path, times, flags);
}

/* Opening: "create" when the file comes into being, "open" when it is there and is to be written. */
static int judge_open(int folder, const char *path, int flags) {
  struct stat found;
  if (!shared || ((flags & O_ACCMODE) == O_RDONLY && !(flags & (O_CREAT | O_TRUNC)))) return GO_ON;
  int before = errno;
  int exists = syscall(SYS_newfstatat, folder, path, &found, 0) == 0;
  errno = before;
  if (exists && (flags & O_ACCMODE) == O_RDONLY && !(flags & O_TRUNC)) return GO_ON;
  if (!exists && !(flags & O_CREAT)) return GO_ON;
  return judge_at(exists ? "open" : "create", folder, path);
}

#define MODE mode_t mode = 0; \
  if (flags & (O_CREAT | O_TMPFILE)) { va_list rest; va_start(rest, flags); mode = va_arg(rest, mode_t); va_end(rest); }

#define OPENS(name) \
  int name(const char *path, int flags, ...) { \
    MODE return judge_open(AT_FDCWD, path, flags) == FAIL ? -1 : REAL(name)(path, flags, mode); \
  }
#define OPENS_AT(name) \
  int name(int at, const char *path, int flags, ...) { \
    MODE return judge_open(at, path, flags) == FAIL ? -1 : REAL(name)(at, path, flags, mode); \
  }

OPENS(open)
OPENS(open64)
OPENS_AT(openat)
OPENS_AT(openat64)

int creat(const char *path, mode_t mode) { return open(path, O_CREAT | O_WRONLY | O_TRUNC, mode); }
int creat64(const char *path, mode_t mode) { return open64(path, O_CREAT | O_WRONLY | O_TRUNC, mode); }

static int judge_mode(const char *path, const char *mode) {
  if (mode[0] == 'r' && !strchr(mode, '+')) return GO_ON;
  return judge_open(AT_FDCWD, path, O_WRONLY | (mode[0] == 'r' ? 0 : O_CREAT));
}

FILE *fopen(const char *path, const char *mode) {
  return judge_mode(path, mode) == FAIL ? NULL : REAL(fopen)(path, mode);
}
FILE *fopen64(const char *path, const char *mode) {
  return judge_mode(path, mode) == FAIL ? NULL : REAL(fopen64)(path, mode);
}

#define MAPS(name, offset) \
  void *name(void *where, size_t size, int protection, int flags, int fd, offset at) { \
    if (shared && fd >= 0 && (flags & MAP_SHARED) && (protection & PROT_WRITE) && judge_fd("mmap", fd, 0) == FAIL) \
      return MAP_FAILED; \
    return REAL(name)(where, size, protection, flags, fd, at); \
  }

MAPS(mmap, off_t)
MAPS(mmap64, off64_t)
