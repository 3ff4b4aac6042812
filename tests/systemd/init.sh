#!/bin/sh
# First process of a guest in which systemd runs the service: as tests/vcan/guest-init.sh, then systemd on the new root.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
mount -t proc proc /proc
mount -t sysfs sys /sys
folder=$modules/$(uname -r)/kernel
for module in net/can/can net/can/can-raw drivers/net/can/dev/can-dev drivers/net/can/vcan fs/overlayfs/overlay; do
    insmod "$folder/$module.ko"
done
mount -t tmpfs memory /mnt
mkdir /mnt/changes /mnt/work /mnt/root
mount -t overlay merged -o lowerdir=/,upperdir=/mnt/changes,workdir=/mnt/work /mnt/root
root=/mnt/root
for part in proc sys dev; do mount --rbind /$part $root/$part; done
mount -t tmpfs memory $root/run
mkdir -p $root/dev/pts $root/dev/shm "$root$results"
mount -t devpts devpts $root/dev/pts
mount -t tmpfs memory $root/dev/shm
mount -t hostfs -o "$results" none "$root$results"
ip link set lo up
ip link add dev vcan0 type vcan
ip link set vcan0 up
# nothing of the host's own services but what the unit itself asks for
rm -rf $root/etc/systemd/system/* $root/lib/systemd/system/*.wants/*
cat >$root/etc/systemd/system/test.target <<EOF
[Unit]
AllowIsolate=yes
Wants=test.service
EOF
cat >$root/etc/systemd/system/test.service <<EOF
[Unit]
DefaultDependencies=no
[Service]
Type=oneshot
ExecStart=/bin/sh -c '/bin/sh $results/command >$results/output 2>&1 </dev/null; echo \$\$? >$results/status; sync; echo o >/proc/sysrq-trigger'
EOF
exec chroot $root /lib/systemd/systemd --unit=test.target --show-status=no --log-target=console --log-level=err
