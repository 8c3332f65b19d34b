# Starts the appliance in Bochs, which starts no kernel by itself: the first sector of its disk. Kernel,
# initial RAM disk and command line are in memory from the beginning (optramimage), so that no firmware has
# to read them, and the kernel is unpacked already. It is entered as QEMU enters it in the lab, by its PVH
# entry (Xen docs/misc/pvh.pandoc; the structures are those of xen/include/public/arch-x86/hvm/start_info.h).
#
# Symbols from outside: kernel_entry, initrd_start, initrd_bytes, words_start.

        .set    e820, 0xe820
        .set    signature, 0x534d4150           # "SMAP"
        .set    range_bytes, 24                 # of PVH's memory map; the firmware fills the first 20
        .set    ranges, 0x8000

        .code16
        .globl  _start
_start: cli
        cld
        xor     %ax, %ax
        mov     %ax, %ds
        mov     %ax, %es
        mov     %ax, %ss
        mov     $_start, %sp

        mov     $ranges, %di
        xor     %ebx, %ebx
next:   mov     $e820, %eax
        mov     $signature, %edx
        mov     $20, %ecx
        int     $0x15
        jc      last
        cmp     $signature, %eax
        jne     last
        movl    $0, 20(%di)
        add     $range_bytes, %di
        incl    range_count
        test    %ebx, %ebx
        jnz     next

last:   lgdt    gdt_pointer
        mov     %cr0, %eax
        or      $1, %al
        mov     %eax, %cr0
        ljmp    $8, $flat

        .code32
flat:   mov     $16, %ax
        mov     %ax, %ds
        mov     %ax, %es
        mov     %ax, %ss
        mov     $start_info, %ebx
        mov     $kernel_entry, %eax
        jmp     *%eax

        .balign 8
gdt:    .quad   0
        .quad   0x00cf9b000000ffff              # code, 4 GiB
        .quad   0x00cf93000000ffff              # data, 4 GiB
gdt_pointer:
        .word   . - gdt - 1
        .long   gdt

        .balign 8
start_info:
        .long   0x336ec578                      # magic
        .long   1                               # version
        .long   0                               # flags
        .long   1                               # modules
        .long   module, 0
        .long   words_start, 0
        .quad   0                               # RSDP: where firmware leaves it
        .long   ranges, 0
range_count:
        .long   0
        .long   0
module: .long   initrd_start, 0
        .long   initrd_bytes, 0
        .quad   0
        .quad   0

        .org    510
        .word   0xaa55
