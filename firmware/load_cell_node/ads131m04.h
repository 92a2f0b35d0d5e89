/* Driver of the ADC ADS131M04: four simultaneous 24-bit channels, 4000 samples per second, gain 128, SPI.
 *
 * Source: Texas Instruments, data sheet SBAS890 (interface, registers). Up to four chips share the
 * SPI clock, the data lines and CLKIN. Each chip has its own chip select.
 */
#ifndef ADS131M04_H
#define ADS131M04_H

#include "node.h"

enum { ADS_CHANNELS = 4, ADS_CHIPS = 4, ADS_FRAME = 18 };

struct ads131m04 {
    /* Transfer a whole frame of a chip: select the chip, transfer 18 bytes both ways (SPI mode 1, at most 25 MHz). */
    void (*transfer)(void *context, uint8_t chip, const uint8_t *out, uint8_t *in);
    void *context;
    uint8_t chips;
    bool ready[ADS_CHIPS];   /* the settings of the chip are written and read back */
};

/* Write the settings of a chip and read them back. Returns false if the chip does not answer or has others. */
bool ads131m04_setup(struct ads131m04 *adc, uint8_t chip);

/* Read the newest conversion of each channel. A chip that has been reset is set up again, and until then its
 * readings are not valid. This function can be used as ``node_board.read``, with the ADC as context. */
void ads131m04_read(void *adc, struct node_reading *readings, uint8_t channels);

#endif
