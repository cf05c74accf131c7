/* The serial line: 1 000 000 baud, 8N1, interrupt-driven in both directions. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

/* Open the line and send a delimiter, which ends any partial frame on it. */
void uart_start(void);

/* Take the next received byte; false if there is none. */
bool uart_receive(uint8_t *byte);

/* The buffer for the next frame; NULL if all are in use. */
uint8_t *uart_free_frame(void);

/* Send the frame in that buffer, up to its delimiter. */
void uart_send(void);

#endif
