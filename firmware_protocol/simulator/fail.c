#include "fail.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void fail(const char *what) {
    fprintf(stderr, "board: %s%s%s\n", what, errno ? ": " : " cannot be used", errno ? strerror(errno) : "");
    exit(2);
}
