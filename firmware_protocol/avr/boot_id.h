#ifndef BOOT_ID_H
#define BOOT_ID_H

#include <stdint.h>

/* Another number at each boot. Call once; takes some milliseconds. */
uint32_t next_boot_id(void);

#endif
