/* A disk that fails, for one process: what happens to files whose path contains ESKER_TEST_PATH.
 * Loaded with LD_PRELOAD by tests/it/faults.rs, which says in ESKER_TEST_FAULT what goes wrong:
 *
 *   full:BYTES     after so many bytes, every write fails with ENOSPC
 *   from:N:ERRNO   from operation N (counted from 0) on, every one fails with ERRNO
 *   once:N:ERRNO   operation N fails, those after it work
 *   short:N        operation N, if it is a write, writes half of its bytes and says so
 *   torn:N         operation N, if it is a write, writes half of its bytes; then the process is gone
 *
 * Operations are writes, syncs, truncations, renames and removals. ESKER_TEST_COUNT names a file that gets their number
 * at the end, ESKER_TEST_LOG one that gets all that was done, to be played back as a power cut would have left it. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static pthread_mutex_t gate = PTHREAD_MUTEX_INITIALIZER;
static long operations, written;
static int log_fd = -2;

#define REAL(name, type, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = dlsym(RTLD_NEXT, name)

static ssize_t real_write(int fd, const void *data, size_t count) {
    REAL("write", ssize_t, int, const void *, size_t);
    return real(fd, data, count);
}

static ssize_t real_pwrite(int fd, const void *data, size_t count, off_t offset) {
    REAL("pwrite64", ssize_t, int, const void *, size_t, off_t);
    return real(fd, data, count, offset);
}

static int watched_path(const char *path) {
    const char *part = getenv("ESKER_TEST_PATH");
    return part && path && strstr(path, part) != NULL;
}

/* The path behind a descriptor, if it is watched. */
static int watched(int fd, char *path, size_t size) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, size - 1);
    if (n <= 0) return 0;
    path[n] = 0;
    return watched_path(path);
}

static void put(const void *data, size_t count) {
    if (real_write(log_fd, data, count) != (ssize_t)count) abort();
}

static void note(char what, const char *path, uint64_t offset, uint64_t count, const void *data) {
    if (log_fd == -2) {
        const char *name = getenv("ESKER_TEST_LOG");
        log_fd = name ? open(name, O_WRONLY | O_CREAT | O_APPEND, 0600) : -1;
    }
    if (log_fd < 0) return;
    uint32_t length = strlen(path);
    put(&what, 1);
    put(&length, 4);
    put(path, length);
    put(&offset, 8);
    put(&count, 8);
    if (data) put(data, count);
}

enum verdict { GOES_ON, FAILS, HALF, HALF_AND_GONE };

/* What becomes of the next operation; called with the gate closed. */
static enum verdict judge(long bytes) {
    const char *fault = getenv("ESKER_TEST_FAULT");
    long mine = operations++, n = 0, code = EIO;
    written += bytes;
    if (!fault) return GOES_ON;
    if (sscanf(fault, "full:%ld", &n) == 1) { errno = ENOSPC; return bytes > 0 && written > n ? FAILS : GOES_ON; }
    if (sscanf(fault, "from:%ld:%ld", &n, &code) == 2) { errno = code; return mine >= n ? FAILS : GOES_ON; }
    if (sscanf(fault, "once:%ld:%ld", &n, &code) == 2) { errno = code; return mine == n ? FAILS : GOES_ON; }
    if (sscanf(fault, "short:%ld", &n) == 1) return mine == n && bytes > 1 ? HALF : GOES_ON;
    if (sscanf(fault, "torn:%ld", &n) == 1) return mine == n ? HALF_AND_GONE : GOES_ON;
    return GOES_ON;
}

static ssize_t put_at(int fd, const void *data, size_t count, off_t offset, int at) {
    char path[4096];
    if (!watched(fd, path, sizeof path)) return at ? real_pwrite(fd, data, count, offset) : real_write(fd, data, count);
    pthread_mutex_lock(&gate);
    enum verdict verdict = judge(count);
    int code = errno;
    ssize_t done = -1;
    if (verdict != FAILS) {
        size_t part = verdict == GOES_ON ? count : count / 2;
        off_t from = at ? offset : lseek(fd, 0, SEEK_CUR);
        done = at ? real_pwrite(fd, data, part, offset) : real_write(fd, data, part);
        code = errno;
        if (done > 0) note('W', path, from, done, data);
    }
    if (verdict == HALF_AND_GONE) _exit(137);
    pthread_mutex_unlock(&gate);
    errno = code;
    return done;
}

ssize_t write(int fd, const void *data, size_t count) { return put_at(fd, data, count, 0, 0); }
ssize_t pwrite(int fd, const void *data, size_t count, off_t offset) { return put_at(fd, data, count, offset, 1); }
ssize_t pwrite64(int fd, const void *data, size_t count, off_t offset) { return put_at(fd, data, count, offset, 1); }

/* An operation without bytes: does it happen? */
static int passes(char what, const char *path, uint64_t offset) {
    pthread_mutex_lock(&gate);
    enum verdict verdict = judge(0);
    int code = errno;
    if (verdict == HALF_AND_GONE) _exit(137);
    if (verdict != FAILS) note(what, path, offset, 0, NULL);
    pthread_mutex_unlock(&gate);
    errno = code;
    return verdict != FAILS;
}

int fsync(int fd) {
    char path[4096];
    REAL("fsync", int, int);
    if (watched(fd, path, sizeof path) && !passes('S', path, 0)) return -1;
    return real(fd);
}

int fdatasync(int fd) {
    char path[4096];
    REAL("fdatasync", int, int);
    if (watched(fd, path, sizeof path) && !passes('S', path, 0)) return -1;
    return real(fd);
}

int ftruncate(int fd, off_t length) {
    char path[4096];
    REAL("ftruncate", int, int, off_t);
    if (watched(fd, path, sizeof path) && !passes('T', path, length)) return -1;
    return real(fd, length);
}

int ftruncate64(int fd, off_t length) {
    char path[4096];
    REAL("ftruncate64", int, int, off_t);
    if (watched(fd, path, sizeof path) && !passes('T', path, length)) return -1;
    return real(fd, length);
}

int rename(const char *from, const char *to) {
    REAL("rename", int, const char *, const char *);
    if (watched_path(to) && !passes('R', to, 0)) return -1;
    return real(from, to);
}

int unlink(const char *path) {
    REAL("unlink", int, const char *);
    if (watched_path(path) && !passes('U', path, 0)) return -1;
    return real(path);
}

__attribute__((destructor)) static void tell(void) {
    const char *name = getenv("ESKER_TEST_COUNT");
    FILE *file = name ? fopen(name, "w") : NULL;
    if (file) {
        fprintf(file, "%ld\n", operations);
        fclose(file);
    }
}
