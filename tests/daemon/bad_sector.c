/* A disk with a bad sector, for one process: reading the byte at BAD_OFFSET of the file with the inode BAD_INODE is an
 * I/O error while the file BAD_SWITCH exists. Load it with LD_PRELOAD. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

static int is_bad(int fd, size_t count, off_t offset)
{
    const char *inode = getenv("BAD_INODE"), *at = getenv("BAD_OFFSET"), *on = getenv("BAD_SWITCH");
    struct stat found;
    if (!inode || !at || !on || fstat(fd, &found) || found.st_ino != (ino_t)atoll(inode))
        return 0;
    off_t bad = atoll(at);
    return offset <= bad && bad < offset + (off_t)count && access(on, F_OK) == 0;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

ssize_t pread64(int fd, void *buffer, size_t count, off64_t offset)
{
    if (is_bad(fd, count, offset))
        return errno = EIO, -1;
    return REAL(pread64)(fd, buffer, count, offset);
}

ssize_t pread(int fd, void *buffer, size_t count, off_t offset) { return pread64(fd, buffer, count, offset); }

ssize_t read(int fd, void *buffer, size_t count)
{
    off_t offset = lseek(fd, 0, SEEK_CUR);
    if (offset >= 0 && is_bad(fd, count, offset))
        return errno = EIO, -1;
    return REAL(read)(fd, buffer, count);
}
