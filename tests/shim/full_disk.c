/* A full disk for one process: after ESKER_TEST_DISK_BYTES bytes, every write to a file whose path contains
 * ESKER_TEST_DISK_PATH fails with ENOSPC. Loaded with LD_PRELOAD by tests/it/bad_input.rs. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static atomic_long written;

static int refused(int fd, size_t count) {
    char link[64], path[4096];
    const char *part = getenv("ESKER_TEST_DISK_PATH"), *limit = getenv("ESKER_TEST_DISK_BYTES");
    if (!part || !limit) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0) return 0;
    path[n] = 0;
    if (!strstr(path, part)) return 0;
    return atomic_fetch_add(&written, (long)count) + (long)count > atol(limit);
}

ssize_t write(int fd, const void *data, size_t count) {
    static ssize_t (*real)(int, const void *, size_t);
    if (!real) real = dlsym(RTLD_NEXT, "write");
    if (refused(fd, count)) { errno = ENOSPC; return -1; }
    return real(fd, data, count);
}

ssize_t pwrite(int fd, const void *data, size_t count, off_t offset) {
    static ssize_t (*real)(int, const void *, size_t, off_t);
    if (!real) real = dlsym(RTLD_NEXT, "pwrite");
    if (refused(fd, count)) { errno = ENOSPC; return -1; }
    return real(fd, data, count, offset);
}

ssize_t pwrite64(int fd, const void *data, size_t count, off_t offset) {
    static ssize_t (*real)(int, const void *, size_t, off_t);
    if (!real) real = dlsym(RTLD_NEXT, "pwrite64");
    if (refused(fd, count)) { errno = ENOSPC; return -1; }
    return real(fd, data, count, offset);
}
