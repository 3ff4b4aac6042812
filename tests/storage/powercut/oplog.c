/* Records what a process does to files below a folder, in order, and makes some of it fail (LD_PRELOAD).
 *
 * DELTAK_OPLOG_ROOT is the folder, DELTAK_OPLOG the log. One record an operation: kind (1 byte), file number (u32),
 * offset (u64), length (u64), then `length` bytes.
 *   O open that creates (name)   W write (bytes)   T truncate to offset   S sync   F sync that failed   U unlink (name)
 *   R rename (old \0 new)   D folder synced   A bytes written to standard output: what the process acknowledged
 * File numbers are those of inodes, so that several processes may write one log, one after another.
 * oplog_fail(kind, errno, first, count) makes operations of a kind (W S D O R U T) fail, counted from 1 and from the call.
 */
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
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

#define MOST 4096
static int log_fd = -1;
static char root[1024];
static size_t root_length;
static uint32_t number_of[MOST]; /* descriptor -> file number, 0: not watched, FOLDER: the watched folder itself */
#define FOLDER 0xffffffffu
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static ssize_t (*real_write)(int, const void *, size_t);
static ssize_t (*real_pwrite)(int, const void *, size_t, off_t);
static int (*real_ftruncate)(int, off_t);
static int (*real_fsync)(int);
static int (*real_close)(int);
static int (*real_unlink)(const char *);
static int (*real_rename)(const char *, const char *);
static int (*real_open)(const char *, int, ...);

static char fail_kind;
static int fail_errno;
static long fail_first, fail_count, seen[128];
static char failed[1100]; /* kind, a space and the path of the operation that failed last */

__attribute__((constructor)) static void start(void) {
    real_write = dlsym(RTLD_NEXT, "write");
    real_pwrite = dlsym(RTLD_NEXT, "pwrite64");
    real_ftruncate = dlsym(RTLD_NEXT, "ftruncate64");
    real_fsync = dlsym(RTLD_NEXT, "fsync");
    real_close = dlsym(RTLD_NEXT, "close");
    real_unlink = dlsym(RTLD_NEXT, "unlink");
    real_rename = dlsym(RTLD_NEXT, "rename");
    real_open = dlsym(RTLD_NEXT, "open64");
    const char *where = getenv("DELTAK_OPLOG"), *below = getenv("DELTAK_OPLOG_ROOT");
    if (below != NULL) { snprintf(root, sizeof root, "%s", below); root_length = strlen(root); }
    if (where != NULL && below != NULL) log_fd = real_open(where, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static int watched(const char *path) { return root_length > 0 && strncmp(path, root, root_length) == 0; }

static void note(char kind, uint32_t number, uint64_t offset, const void *bytes, uint64_t length) {
    if (log_fd < 0) return;
    unsigned char head[21];
    head[0] = (unsigned char)kind;
    memcpy(head + 1, &number, 4); memcpy(head + 5, &offset, 8); memcpy(head + 13, &length, 8);
    struct iovec parts[2] = {{head, sizeof head}, {(void *)bytes, (size_t)length}};
    if (writev(log_fd, parts, length > 0 ? 2 : 1) < 0) _exit(99);
}

void oplog_fail(char kind, int error, long first, long count) {
    pthread_mutex_lock(&lock);
    fail_kind = kind; fail_errno = error; fail_first = first; fail_count = count; failed[0] = 0;
    memset(seen, 0, sizeof seen);
    pthread_mutex_unlock(&lock);
}
long oplog_seen(char kind) { return seen[(int)kind]; }
const char *oplog_failed(void) { return failed; }

static int fails(char kind, int fd, const char *path) {
    long count = ++seen[(int)kind];
    if (fail_kind != kind || count < fail_first || count >= fail_first + fail_count) return 0;
    char link[64], name[1024] = "";
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    if (path == NULL && readlink(link, name, sizeof name - 1) > 0) path = name;
    snprintf(failed, sizeof failed, "%c %s", kind, path == NULL ? "" : path);
    errno = fail_errno;
    return 1;
}

static int opened(const char *path, int flags, mode_t mode) {
    if (!watched(path)) return real_open(path, flags, mode);
    pthread_mutex_lock(&lock);
    int existed = access(path, F_OK) == 0;
    int fd = fails('O', -1, path) ? -1 : real_open(path, flags, mode);
    if (fd >= 0 && fd < MOST) {
        struct stat info;
        if (fstat(fd, &info) == 0) number_of[fd] = S_ISDIR(info.st_mode) ? FOLDER : (uint32_t)info.st_ino;
        if (number_of[fd] != FOLDER) {
            if (!existed) note('O', number_of[fd], 0, path, strlen(path));
            else if (flags & O_TRUNC) note('T', number_of[fd], 0, NULL, 0);
        }
    }
    pthread_mutex_unlock(&lock);
    return fd;
}

int open(const char *path, int flags, ...) {
    va_list rest; va_start(rest, flags); mode_t mode = (flags & O_CREAT) ? va_arg(rest, mode_t) : 0; va_end(rest);
    return opened(path, flags, mode);
}
int open64(const char *path, int flags, ...) {
    va_list rest; va_start(rest, flags); mode_t mode = (flags & O_CREAT) ? va_arg(rest, mode_t) : 0; va_end(rest);
    return opened(path, flags, mode);
}

static uint32_t file_of(int fd) { return fd >= 0 && fd < MOST ? number_of[fd] : 0; }

ssize_t write(int fd, const void *bytes, size_t length) {
    pthread_mutex_lock(&lock);
    uint32_t number = file_of(fd);
    ssize_t done;
    if (number != 0 && number != FOLDER) {
        off_t place = lseek(fd, 0, SEEK_CUR);
        done = fails('W', fd, NULL) ? -1 : real_write(fd, bytes, length);
        if (done > 0) note('W', number, (uint64_t)place, bytes, (uint64_t)done);
    } else {
        if (fd == 1) note('A', 0, 0, bytes, length);
        done = real_write(fd, bytes, length);
    }
    pthread_mutex_unlock(&lock);
    return done;
}

ssize_t pwrite64(int fd, const void *bytes, size_t length, off_t place) {
    pthread_mutex_lock(&lock);
    uint32_t number = file_of(fd);
    ssize_t done = number != 0 && fails('W', fd, NULL) ? -1 : real_pwrite(fd, bytes, length, place);
    if (done > 0 && number != 0 && number != FOLDER) note('W', number, (uint64_t)place, bytes, (uint64_t)done);
    pthread_mutex_unlock(&lock);
    return done;
}
ssize_t pwrite(int fd, const void *bytes, size_t length, off_t place) { return pwrite64(fd, bytes, length, place); }

int ftruncate64(int fd, off_t size) {
    pthread_mutex_lock(&lock);
    uint32_t number = file_of(fd);
    int done = number != 0 && fails('T', fd, NULL) ? -1 : real_ftruncate(fd, size);
    if (done == 0 && number != 0) note('T', number, (uint64_t)size, NULL, 0);
    pthread_mutex_unlock(&lock);
    return done;
}
int ftruncate(int fd, off_t size) { return ftruncate64(fd, size); }

static int synced(int fd) {
    pthread_mutex_lock(&lock);
    uint32_t number = file_of(fd);
    int done = fails(number == FOLDER ? 'D' : 'S', fd, NULL) ? -1 : 0; /* the log is the disk: nothing need be flushed for real */
    if (done == 0) note(number == FOLDER ? 'D' : 'S', number, 0, NULL, 0);
    else if (number != FOLDER) note('F', number, 0, NULL, 0);
    pthread_mutex_unlock(&lock);
    return done;
}
int fsync(int fd) { return file_of(fd) ? synced(fd) : real_fsync(fd); }
int fdatasync(int fd) { return file_of(fd) ? synced(fd) : real_fsync(fd); }

int close(int fd) {
    pthread_mutex_lock(&lock);
    if (fd >= 0 && fd < MOST) number_of[fd] = 0;
    int done = real_close(fd);
    pthread_mutex_unlock(&lock);
    return done;
}

int unlink(const char *path) {
    pthread_mutex_lock(&lock);
    int done = watched(path) && fails('U', -1, path) ? -1 : real_unlink(path);
    if (done == 0 && watched(path)) note('U', 0, 0, path, strlen(path));
    pthread_mutex_unlock(&lock);
    return done;
}

int rename(const char *old, const char *new) {
    pthread_mutex_lock(&lock);
    int done = watched(old) && fails('R', -1, old) ? -1 : real_rename(old, new);
    if (done == 0 && watched(old)) {
        char both[2100];
        int length = snprintf(both, sizeof both, "%s%c%s", old, 0, new);
        note('R', 0, 0, both, (uint64_t)length);
    }
    pthread_mutex_unlock(&lock);
    return done;
}
