/* What the programs on libmodbus share: the end of their input, and how they fail. */
#include <errno.h>
#include <modbus.h>
#include <poll.h>
#include <stdio.h>
#include <unistd.h>

static int input_ended(void)
{
    struct pollfd input = {.fd = STDIN_FILENO, .events = POLLIN};
    char byte;
    return poll(&input, 1, 0) > 0 && read(STDIN_FILENO, &byte, 1) <= 0;
}

static int fail(const char *what)
{
    fprintf(stderr, "%s: %s\n", what, modbus_strerror(errno));
    return 1;
}
