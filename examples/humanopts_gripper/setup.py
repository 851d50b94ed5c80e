from setuptools import find_packages, setup

NAME = 'humanopts_gripper'

setup(
    name=NAME,
    version='0.1.0',
    install_requires=['numpy'],
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    entry_points={'console_scripts': ['gripper = humanopts_gripper.node:main']},
)
