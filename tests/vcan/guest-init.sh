#!/bin/sh
# First process of the guest. Its root is the host's, read-only, under a file system in memory: the guest may write
# anywhere and the host sees only the results folder. The kernel hands its unknown arguments over as environment.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
mount -t proc proc /proc
mount -t sysfs sys /sys
folder=$modules/$(uname -r)/kernel
for module in net/can/can net/can/can-raw drivers/net/can/dev/can-dev drivers/net/can/vcan drivers/net/can/slcan/slcan fs/overlayfs/overlay; do
    insmod "$folder/$module.ko"
done
mount -t tmpfs memory /mnt
mkdir /mnt/changes /mnt/work /mnt/root
mount -t overlay merged -o lowerdir=/,upperdir=/mnt/changes,workdir=/mnt/work /mnt/root
for part in proc sys dev; do mount --rbind /$part /mnt/root/$part; done
mkdir -p /mnt/root/dev/pts /mnt/root/dev/shm "/mnt/root$results"
mount -t devpts devpts /mnt/root/dev/pts
mount -t tmpfs memory /mnt/root/dev/shm
mount -t hostfs -o "$results" none "/mnt/root$results"
ip link set lo up
ip link add dev vcan0 type vcan
ip link set vcan0 up
chroot /mnt/root /bin/sh "$results/command" >"/mnt/root$results/output" 2>&1 </dev/null
echo $? >"/mnt/root$results/status"
sync
echo o >/proc/sysrq-trigger
sleep 10
