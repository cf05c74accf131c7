/* The simulated board: runs a firmware with its serial line on a pseudo-terminal or in a file. Commands on standard input
 * set the analogue inputs; `usage` lists them. */
#define _GNU_SOURCE
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "device.h"
#include "fail.h"

#define CHANNELS 8
#define MAX_BEHIND_S 0.1     /* beyond this lag behind real time, the clock is set anew instead of catching up */
#define SCRIPT_BYTES 1000000 /* of commands that wait for their time */

static const char usage[] =
    "usage: board FIRMWARE.elf [--link PATH] [--eeprom FILE]\n"
    "       board FIRMWARE.elf --seconds S --output FILE [--input FILE] [--eeprom FILE]\n"
    "Without --seconds it runs in real time until standard input ends. The serial line is a pseudo-terminal: its path is\n"
    "printed first, and --link makes a link to it at PATH. With --seconds it runs S simulated seconds as fast as it can\n"
    "and writes the bytes that the device sends to --output; --input holds bytes that the device receives from the start.\n"
    "Commands on standard input, one per line, run at SECONDS of simulated time, or at once:\n"
    "  [@SECONDS] mV mV ...     set the voltages at ADC0, ADC1, ...\n"
    "  [@SECONDS] send HEX      send bytes to the device\n"
    "  [@SECONDS] reset         press the reset button\n";

static char script[SCRIPT_BYTES]; /* commands that have not run yet */
static size_t script_length;
static bool script_ended;
static volatile sig_atomic_t stopped;

static void stop(int signal_number) {
    (void)signal_number;
    stopped = 1;
}


static double wall_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec / 1e9;
}

static void send_hex(const char *at) {
    for (char pair[3] = ""; isxdigit((unsigned char)at[0]) && isxdigit((unsigned char)at[1]); at += 2) {
        memcpy(pair, at, 2);
        queue_put(&to_device, (uint8_t)strtoul(pair, NULL, 16));
    }
}

static void set_voltages(char *at) {
    for (int channel = 0; channel < CHANNELS; channel++) {
        char *end;
        unsigned long millivolts = strtoul(at, &end, 10);
        if (end == at) return;
        device_set_voltage(channel, (unsigned)millivolts);
        at = end;
    }
}

static void run_command(char *line) {
    if (strncmp(line, "send ", 5) == 0) {
        send_hex(line + 5);
    } else if (strncmp(line, "reset", 5) == 0) {
        device_reset();
    } else {
        set_voltages(line);
    }
}

/* Run the commands whose time has come. */
static void follow_script(void) {
    for (char *end; (end = memchr(script, '\n', script_length)) != NULL;) {
        char *line = script;
        if (*line == '@' && strtod(line + 1, &line) > device_s()) return;
        *end = 0;
        run_command(line + strspn(line, " "));
        script_length -= (size_t)(end + 1 - script);
        memmove(script, end + 1, script_length);
    }
}

static void read_script(void) {
    errno = 0;
    if (script_length == sizeof script) fail("more than 1 MB of commands waiting on standard input");
    ssize_t got = read(STDIN_FILENO, script + script_length, sizeof script - script_length);
    if (got > 0) script_length += (size_t)got;
    script_ended = got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR);
}

static bool run_fast(double seconds, const char *output) {
    FILE *file = fopen(output, "wb");
    if (file == NULL) fail(output);
    bool is_running = true;
    while (!script_ended) read_script();
    while (is_running && !stopped && device_s() < seconds) {
        follow_script();
        is_running = device_run();
        fwrite(from_device.bytes + from_device.begin, 1, from_device.end - from_device.begin, file);
        from_device.begin = from_device.end;
    }
    if (fclose(file) != 0) fail(output);
    return is_running;
}

/* Open a raw pseudo-terminal and print its path. This process keeps the other end open, too: otherwise the line would
 * hang up when one host closes it and before the next opens it. */
static int open_line(const char *link_path) {
    struct termios raw;
    int line = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (line < 0 || grantpt(line) != 0 || unlockpt(line) != 0) fail("pseudo-terminal");
    int far = open(ptsname(line), O_RDWR | O_NOCTTY);
    if (far < 0 || tcgetattr(far, &raw) != 0) fail("pseudo-terminal");
    cfmakeraw(&raw);
    tcsetattr(far, TCSANOW, &raw);
    if (link_path != NULL && symlink(ptsname(line), link_path) != 0) fail(link_path);
    printf("serial %s\n", link_path != NULL ? link_path : ptsname(line));
    fflush(stdout);
    return line;
}

/* Pass bytes between line and device. Waits until standard input or the line is readable, for `wait_s` at most. */
static void exchange(int line, double wait_s) {
    ssize_t passed = write(line, from_device.bytes + from_device.begin, from_device.end - from_device.begin);
    if (passed > 0) from_device.begin += (size_t)passed;
    struct pollfd ready[] = {{.fd = STDIN_FILENO, .events = POLLIN}, {.fd = line, .events = POLLIN}};
    struct timespec time = {.tv_nsec = wait_s > 0 ? (long)(wait_s * 1e9) : 0};
    if (ppoll(ready, 2, &time, NULL) <= 0) return;
    if (ready[0].revents) read_script();
    uint8_t bytes[4096];
    ssize_t got = ready[1].revents ? read(line, bytes, sizeof bytes) : 0;
    for (ssize_t i = 0; i < got; i++) queue_put(&to_device, bytes[i]);
}

static bool run_live(int line) {
    double began_s = wall_s() - device_s();
    bool is_running = true;
    while (is_running && !stopped && !script_ended) {
        follow_script();
        is_running = device_run();
        double ahead_s = device_s() - (wall_s() - began_s);
        if (ahead_s < -MAX_BEHIND_S) began_s = wall_s() - device_s();
        exchange(line, ahead_s);
    }
    return is_running;
}

static void send_file(const char *path) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) fail(path);
    for (int byte = getc(file); byte != EOF; byte = getc(file)) queue_put(&to_device, (uint8_t)byte);
    fclose(file);
}

static void stop_on_signals(void) {
    struct sigaction action = {.sa_handler = stop};
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
}

typedef struct {
    const char *elf, *link, *eeprom, *seconds, *output, *input;
} options;

/* Print the usage and exit if the options are wrong. */
static options read_options(int count, char **words) {
    static const struct option names[] = {{"link", 1, NULL, 'l'},    {"eeprom", 1, NULL, 'e'}, {"seconds", 1, NULL, 's'},
                                          {"output", 1, NULL, 'o'}, {"input", 1, NULL, 'i'},  {NULL, 0, NULL, 0}};
    options given = {0};
    for (int name; (name = getopt_long(count, words, "", names, NULL)) != -1;) {
        if (name == 'l') given.link = optarg;
        if (name == 'e') given.eeprom = optarg;
        if (name == 's') given.seconds = optarg;
        if (name == 'o') given.output = optarg;
        if (name == 'i') given.input = optarg;
        if (name == '?') optind = count;
    }
    given.elf = optind == count - 1 ? words[optind] : NULL;
    if (given.elf == NULL || (given.seconds == NULL) != (given.output == NULL)) {
        fputs(usage, stderr);
        exit(2);
    }
    return given;
}

int main(int count, char **words) {
    options given = read_options(count, words);
    stop_on_signals();
    device_start(given.elf);
    if (given.eeprom) device_load_eeprom(given.eeprom);
    if (given.input) send_file(given.input);
    bool is_alive = given.seconds ? run_fast(strtod(given.seconds, NULL), given.output) : run_live(open_line(given.link));
    if (given.link) unlink(given.link);
    if (given.eeprom) device_save_eeprom(given.eeprom);
    printf("baud %u\nlight_changes %u\n", device_baud(), device_light_changes());
    if (!is_alive) fputs("board: the firmware has crashed\n", stderr);
    return is_alive ? 0 : 1;
}
