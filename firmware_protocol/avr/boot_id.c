#include "boot_id.h"

#include <avr/eeprom.h>

static uint32_t EEMEM boots;

/* Spread the boot count over 32 bits, so that two devices with similar counts rarely share an id. Every step is
 * invertible, so two counts never give the same id. */
static uint32_t mixed(uint32_t count) {
    count ^= count >> 16;
    count *= 0x7FEB352DUL;
    count ^= count >> 15;
    count *= 0x846CA68BUL;
    return count ^ count >> 16;
}

uint32_t next_boot_id(void) {
    uint32_t count = eeprom_read_dword(&boots) + 1;
    eeprom_update_dword(&boots, count); /* mostly writes one byte; EEPROM cells last for 100 000 writes */
    return mixed(count);
}
