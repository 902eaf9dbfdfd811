#!/bin/bash
# Boots a real systemd on a root of its own, in namespaces of its own: nothing of this machine is written or seen, but /usr,
# the sources and the Python, read-only. Started by systemd_box.py under `unshare`, which gives the namespaces.
# Arguments: an empty folder for the root; the files to install there; the sources; Python's prefix; its site-packages.
set -euo pipefail
root=$1 files=$2 sources=$3 python=$4 packages=$5
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
shown() { mkdir -p "$2"; mount --bind "$1" "$2"; mount -o remount,bind,ro "$2"; }

mount --make-rprivate /
mount -t tmpfs -o mode=755 none "$root"
cd "$root"
mkdir -p etc/systemd/system/galen-hw.service.d var/lib var/log/journal run tmp proc sys dev opt/galen-hw/bin root home
for name in bin sbin lib lib64; do ln -s usr/$name $name; done
shown /usr usr
shown "$python" opt/python
shown "$sources" opt/sources
shown "$packages" "opt/galen-hw/lib/$(basename "$(dirname "$packages")")/site-packages"

mount -t proc proc proc
mount --bind proc/sys proc/sys
mount -o remount,bind,ro proc/sys
mount -t sysfs -o ro sysfs sys
mount -t cgroup2 cgroup2 sys/fs/cgroup
mount -t tmpfs -o mode=755 none dev
mkdir dev/pts dev/shm
mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
mount -t tmpfs none dev/shm
ln -s pts/ptmx dev/ptmx
ln -s /proc/self/fd dev/fd
for name in null zero full random urandom tty; do touch dev/$name; mount --bind /dev/$name dev/$name; done

# An environment of Python at the place that the unit names, of this one's Python and packages.
printf 'home = /opt/python/bin\ninclude-system-site-packages = false\n' > opt/galen-hw/pyvenv.cfg
ln -s /opt/python/bin/python3 opt/galen-hw/bin/python
printf '#!/opt/galen-hw/bin/python\nimport sys\nfrom galen_hw.cli import main\nsys.exit(main())\n' > opt/galen-hw/bin/galen-hw
chmod 755 opt/galen-hw/bin/galen-hw

cp /etc/passwd /etc/group /etc/nsswitch.conf /etc/ld.so.cache etc/
touch etc/machine-id
cp -r "$files"/. .
systemd-sysusers --root=.
# What a machine has and this box has not; each would wait for it, or set something of the kernel that is not the box's.
for unit in systemd-{sysctl,modules-load,random-seed,binfmt,firstboot,udevd,machine-id-commit,update-utmp,logind}.service \
  systemd-{udev-trigger,tmpfiles-setup-dev}.service dev-{hugepages,mqueue}.mount sys-kernel-{debug,tracing,config}.mount \
  sys-fs-fuse-connections.mount proc-sys-fs-binfmt_misc.automount; do
  ln -s /dev/null etc/systemd/system/$unit
done
printf '[Unit]\nWants=systemd-journald.service\n' > etc/systemd/system/box.target

mkdir old
pivot_root . old
umount -l /old
exec env -i container=galen-hw PATH="$PATH" /lib/systemd/systemd --unit=box.target --log-target=null
