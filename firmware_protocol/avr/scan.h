/* Scans of all channels, driven by timer and ADC interrupts. */
#ifndef SCAN_H
#define SCAN_H

#include <stdbool.h>
#include <stdint.h>

#include "beamtouch_protocol.h"

/* Prepare the ADC. */
void scan_prepare(void);

/* Start scanning at this rate. If the ADC or the line cannot keep it, change nothing and return false. */
bool scan_start(uint16_t rate_hz, uint8_t oversampling);

/* Stop scanning and discard the readings that wait to be sent. */
void scan_stop(void);

/* The next reading to send, or NULL. It stays unchanged until scan_forget. */
const beamtouch_message *scan_waiting(void);

/* Discard the reading that scan_waiting returned, after it has been sent. */
void scan_forget(void);

#endif
