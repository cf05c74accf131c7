/* Scans of all channels, by timer and ADC interrupts. */
#ifndef SCAN_H
#define SCAN_H

#include <stdbool.h>
#include <stdint.h>

#include "beamtouch_protocol.h"

/* Make the ADC ready. */
void scan_prepare(void);

/* Scan from now on at this rate; false, and nothing changes, if the ADC or the line cannot keep it. */
bool scan_start(uint16_t rate_hz, uint8_t oversampling);

/* Scan no more; forgets what waits to be sent. */
void scan_stop(void);

/* The reading that waits to be sent, NULL if none does. It stays as it is until scan_forget. */
const beamtouch_message *scan_waiting(void);

/* The reading that waited has been sent. */
void scan_forget(void);

#endif
