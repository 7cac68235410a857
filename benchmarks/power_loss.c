// SPDX-License-Identifier: Apache-2.0
/* What a process does to the files of one folder, in its order, written to a log: for power_loss.py, by LD_PRELOAD.

   An event is a head and two texts: the data of a write, or one or two paths. Changes are logged after they were made,
   a sync before (SYNC) and after (SYNCED). One thread at a time changes and logs. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { OPEN = 1, WRITE, SYNC, SYNCED, RENAME, MAKE, REMOVE, CUT, CLOSE };
enum { FILES = 4096 };

struct head {
    int64_t time, offset;
    uint32_t kind, process, file, first, second, reserved;
};

static char watched[FILES];
static pthread_mutex_t one_at_a_time = PTHREAD_MUTEX_INITIALIZER;

#define REAL(name) \
    static __typeof__(&name) real; \
    if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static int log_file(void) {
    static int file = -1;
    static pid_t owner;
    if (owner != getpid()) {
        owner = getpid();
        file = (int)syscall(SYS_openat, AT_FDCWD, getenv("POWER_LOSS_LOG"), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
    }
    return file;
}

static void event(uint32_t kind, int file, int64_t offset, const void *first, size_t size, const char *second) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    struct head head = {now.tv_sec * 1000000000LL + now.tv_nsec, offset, kind, (uint32_t)getpid(), (uint32_t)file,
                        (uint32_t)size, second ? (uint32_t)strlen(second) : 0, 0};
    struct iovec parts[3] = {{&head, sizeof head}, {(void *)first, size}, {(void *)second, head.second}};
    if (syscall(SYS_writev, log_file(), parts, 3) < 0) abort();
}

/* The absolute path, where it is in the folder; else NULL. */
static const char *inside(int folder, const char *path, char *buffer) {
    const char *root = getenv("POWER_LOSS_FOLDER");
    if (!root || !path) return NULL;
    if (path[0] == '/') {
        snprintf(buffer, PATH_MAX, "%s", path);
    } else {
        char link[64];
        if (folder == AT_FDCWD) snprintf(link, sizeof link, "/proc/self/cwd");
        else snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
        ssize_t length = readlink(link, buffer, PATH_MAX - 1);
        if (length < 0) return NULL;
        snprintf(buffer + length, PATH_MAX - length, "/%s", path);
    }
    size_t length = strlen(root);
    return strncmp(buffer, root, length) == 0 && (buffer[length] == '/' || !buffer[length]) ? buffer : NULL;
}

static int is_watched(int file) { return file >= 0 && file < FILES && watched[file]; }

static int opened(int file, int folder, const char *path, int flags) {
    char buffer[PATH_MAX];
    const char *found = file >= 0 && file < FILES ? inside(folder, path, buffer) : NULL;
    if (found) {
        watched[file] = 1;
        event(OPEN, file, flags & O_TRUNC, found, strlen(found), NULL);
    }
    return file;
}

#define OPENING(name, parameters, folder, ...) \
    int name parameters { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, mode_t) : 0; \
        va_end(rest); \
        REAL(name); \
        pthread_mutex_lock(&one_at_a_time); \
        int file = opened(real(__VA_ARGS__, mode), folder, path, flags); \
        pthread_mutex_unlock(&one_at_a_time); \
        return file; \
    }
OPENING(open, (const char *path, int flags, ...), AT_FDCWD, path, flags)
OPENING(open64, (const char *path, int flags, ...), AT_FDCWD, path, flags)
OPENING(openat, (int folder, const char *path, int flags, ...), folder, folder, path, flags)
OPENING(openat64, (int folder, const char *path, int flags, ...), folder, folder, path, flags)

int close(int file) {
    REAL(close);
    if (!is_watched(file)) return real(file);
    pthread_mutex_lock(&one_at_a_time);
    watched[file] = 0;
    event(CLOSE, file, 0, NULL, 0, NULL);
    int result = real(file);
    pthread_mutex_unlock(&one_at_a_time);
    return result;
}

ssize_t write(int file, const void *data, size_t size) {
    REAL(write);
    if (!is_watched(file)) return real(file, data, size);
    pthread_mutex_lock(&one_at_a_time);
    int64_t offset = lseek(file, 0, SEEK_CUR);
    ssize_t written = real(file, data, size);
    if (written > 0) event(WRITE, file, offset, data, (size_t)written, NULL);
    pthread_mutex_unlock(&one_at_a_time);
    return written;
}

#define CUTTING(name, type) \
    int name(int file, type size) { \
        REAL(name); \
        if (!is_watched(file)) return real(file, size); \
        pthread_mutex_lock(&one_at_a_time); \
        int result = real(file, size); \
        if (!result) event(CUT, file, size, NULL, 0, NULL); \
        pthread_mutex_unlock(&one_at_a_time); \
        return result; \
    }
CUTTING(ftruncate, off_t)
CUTTING(ftruncate64, off64_t)

/* other threads go on meanwhile, as they do without us */
#define SYNCING(name) \
    int name(int file) { \
        REAL(name); \
        if (!is_watched(file)) return real(file); \
        event(SYNC, file, 0, NULL, 0, NULL); \
        int result = real(file); \
        if (!result) event(SYNCED, file, 0, NULL, 0, NULL); \
        return result; \
    }
SYNCING(fsync)
SYNCING(fdatasync)

#define CHANGING(name, parameters, kind, folder, path, other_folder, other, ...) \
    int name parameters { \
        REAL(name); \
        char first[PATH_MAX], second[PATH_MAX]; \
        const char *a = inside(folder, path, first), *b = inside(other_folder, other, second); \
        pthread_mutex_lock(&one_at_a_time); \
        int result = real(__VA_ARGS__); \
        if (!result && a) event(kind, -1, 0, a, strlen(a), b); \
        pthread_mutex_unlock(&one_at_a_time); \
        return result; \
    }
CHANGING(rename, (const char *path, const char *other), RENAME, AT_FDCWD, path, AT_FDCWD, other, path, other)
CHANGING(renameat, (int from, const char *path, int to, const char *other), RENAME, from, path, to, other, from, path, to, other)
CHANGING(mkdir, (const char *path, mode_t mode), MAKE, AT_FDCWD, path, AT_FDCWD, NULL, path, mode)
CHANGING(mkdirat, (int folder, const char *path, mode_t mode), MAKE, folder, path, AT_FDCWD, NULL, folder, path, mode)
CHANGING(unlink, (const char *path), REMOVE, AT_FDCWD, path, AT_FDCWD, NULL, path)
CHANGING(unlinkat, (int folder, const char *path, int flags), REMOVE, folder, path, AT_FDCWD, NULL, folder, path, flags)
CHANGING(rmdir, (const char *path), REMOVE, AT_FDCWD, path, AT_FDCWD, NULL, path)
