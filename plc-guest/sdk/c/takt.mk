# Makes objects of control programs in C: build/NAME.o of NAME.c, build/takt.o, which each program needs, and
# build/takt_math.o, which has functions of math.h. For the end of a Makefile.
TAKT ?= takt
CC ?= gcc
CFLAGS ?= -O2 -g -Wall -Wextra
SDK := $(patsubst %/,%,$(dir $(lastword $(MAKEFILE_LIST))))
# There is no C library and no loader: all addresses are fixed when the image is linked. A function whose variables are larger
# than the room below a stack touches each page, so that it faults instead of writing into another task's stack.
FREESTANDING = -std=c11 -ffreestanding -fno-pie -fno-stack-protector -fstack-clash-protection -fno-math-errno \
	-fno-asynchronous-unwind-tables -ffunction-sections -fdata-sections -mno-avx -I$(SDK)
# GNU's assembler notes which registers are used, so that `takt plc build` refuses those that the PLC's kernel does not keep.
NOTED := $(shell $(CC) -Wa,-mx86-used-note=yes -c -x c /dev/null -o /dev/null 2>/dev/null && echo -Wa,-mx86-used-note=yes)

build/%.o: %.c $(SDK)/takt.h
	@mkdir -p build
	$(CC) $(CFLAGS) $(FREESTANDING) $(NOTED) -MMD -MP -c $< -o $@

# gcc would make calls of memcpy of the loops that memcpy is made of, and of sqrt of what sqrt is made of.
build/takt.o build/takt_math.o: build/%.o: $(SDK)/%.c $(SDK)/takt.h
	@mkdir -p build
	$(CC) $(CFLAGS) $(FREESTANDING) $(NOTED) -MMD -MP -fno-builtin -fno-tree-loop-distribute-patterns -c $< -o $@

# The headers that each object was made of.
-include $(wildcard build/*.d)
