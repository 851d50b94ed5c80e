from setuptools import find_packages, setup

NAME = 'humanopts_ros'

setup(
    name=NAME,
    version='0.1.0',
    install_requires=['numpy>=1.26.4', 'psutil>=5.9.8', 'pyyaml>=6.0.1'],
    packages=find_packages(exclude=['test']),
    package_data={NAME: ['py.typed', 'quick_discovery.xml', 'loopback_discovery.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
)
