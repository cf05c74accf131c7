/* A Modbus unit on libmodbus, for tests: input registers 0 to 9 hold 1000 and up, holding registers 2000 and up.
 *
 *     libmodbus_server tcp PORT     one connection after the other, on 127.0.0.1
 *     libmodbus_server rtu PATH     unit 1 at 115200 baud
 *
 * Says "ready" once it can be asked; ends with its standard input.
 */
#include <errno.h>
#include <modbus.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { REGISTERS = 10 };

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

int main(int argc, char **argv)
{
    if (argc != 3)
        return 2;
    int is_tcp = strcmp(argv[1], "tcp") == 0;
    modbus_t *unit = is_tcp ? modbus_new_tcp("127.0.0.1", atoi(argv[2])) : modbus_new_rtu(argv[2], 115200, 'N', 8, 1);
    modbus_mapping_t *registers = modbus_mapping_new(0, 0, REGISTERS, REGISTERS);
    if (unit == NULL || registers == NULL)
        return fail("new");
    for (int i = 0; i < REGISTERS; i++) {
        registers->tab_input_registers[i] = (uint16_t)(1000 + i);
        registers->tab_registers[i] = (uint16_t)(2000 + i);
    }
    modbus_set_slave(unit, 1);
    modbus_set_indication_timeout(unit, 0, 200000);
    int listener = is_tcp ? modbus_tcp_listen(unit, 1) : modbus_connect(unit);
    if (listener < 0)
        return fail("listen");
    puts("ready");
    fflush(stdout);
    while (!input_ended()) {
        uint8_t request[MODBUS_MAX_ADU_LENGTH];
        if (is_tcp && modbus_get_socket(unit) < 0) {
            struct pollfd waiting = {.fd = listener, .events = POLLIN};
            if (poll(&waiting, 1, 200) > 0)
                modbus_tcp_accept(unit, &listener);
            continue;
        }
        int length = modbus_receive(unit, request);
        if (length > 0)
            modbus_reply(unit, request, length, registers);
        else if (is_tcp && length < 0 && errno != ETIMEDOUT)
            modbus_close(unit), modbus_set_socket(unit, -1);
    }
    modbus_mapping_free(registers);
    modbus_free(unit);
    return 0;
}
