/* A Modbus TCP client on libmodbus, for tests.
 *
 *     libmodbus_client PORT ADDRESS COUNT POLLS PAUSE_US WORD_ORDER
 *
 * Reads COUNT input registers from ADDRESS on, POLLS times, until its standard input ends. Prints a line for each: the
 * registers, then the floats at offsets 8 to 20 as libmodbus decodes them. WORD_ORDER is abcd or cdab.
 */
#include "libmodbus_common.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char **argv)
{
    if (argc != 7)
        return 2;
    int address = atoi(argv[2]), count = atoi(argv[3]), polls = atoi(argv[4]), pause_us = atoi(argv[5]);
    int is_little = strcmp(argv[6], "cdab") == 0;
    modbus_t *server = modbus_new_tcp("127.0.0.1", atoi(argv[1]));
    if (server == NULL || modbus_set_response_timeout(server, 30, 0) || modbus_connect(server))
        return fail("connect");
    for (int i = 0; i < polls && !input_ended(); i++) {
        uint16_t registers[MODBUS_MAX_READ_REGISTERS];
        if (modbus_read_input_registers(server, address, count, registers) != count)
            return fail("read");
        for (int j = 0; j < count; j++)
            printf("%u ", registers[j]);
        for (int j = 8; j + 1 < count && j <= 20; j += 2)
            printf("%.9g ", is_little ? modbus_get_float_cdab(registers + j) : modbus_get_float_abcd(registers + j));
        puts("");
        fflush(stdout);
        usleep(pause_us);
    }
    modbus_close(server);
    modbus_free(server);
    return 0;
}
