#ifndef BOOT_ID_H
#define BOOT_ID_H

#include <stdint.h>

/* A different number at each boot. Call it once per boot; it takes some milliseconds. */
uint32_t next_boot_id(void);

#endif
